/* FMI 3.0: a variable that is an array stands for consecutive scalars of the table, from its value reference
 * on. */
#ifndef FMI3_ARRAYS_H
#define FMI3_ARRAYS_H

#include "fmu.h"

/* *scalars: nvalues references of the scalars of the n variables `ref`, in `ref` itself without arrays, else
 * in the `half` (0, 1) of the instance's own room, until the next call with it. FMU_ERROR if their number is
 * another one. */
int fmi3_scalars(fmu *f, const char *function, int half, const unsigned *ref, size_t n, size_t nvalues,
                 const unsigned **scalars);

#endif
