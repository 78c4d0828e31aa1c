/* The numbers that a step works on: one number each, or, where PH_WIDTH is defined, those of so many runs of
 * one model side by side, which go through the same operations. Sources that are compiled for both have
 * decisions on numbers in the words below; a step of the second kind leaves the runs for which any of them is
 * unusual. */
#ifndef PH_REAL_H
#define PH_REAL_H

#include <math.h>

#ifdef PH_WIDTH
#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wpsabi" /* nothing of this type goes from one compiler's code to another's  \
                                          */
#endif
typedef double ph_real __attribute__((vector_size(8 * PH_WIDTH), aligned(8)));
typedef long long ph_truth __attribute__((vector_size(8 * PH_WIDTH), aligned(8)));

#define PH_REAL_WHERE(c, a, b) ((ph_real)(((c) & (ph_truth)(a)) | (~(c) & (ph_truth)(b))))
#define PH_REAL_ABS(a) ((ph_real)((ph_truth)(a) & 0x7fffffffffffffffLL))
#define PH_REAL_SPREAD(a) ((a) - (ph_real){0.0}) /* the same number for all */
#define PH_NOT(c) (~(c))
#define PH_TRUE ((ph_truth){0} == 0)
#define PH_RUNS PH_WIDTH
#define PH_RUN(a, l) ((a)[l]) /* that of run l */

static inline ph_real ph_real_sqrt(ph_real a) {
    for (int l = 0; l < PH_WIDTH; l++)
        a[l] = sqrt(a[l]);
    return a;
}
#define PH_REAL_SQRT(a) ph_real_sqrt(a)

static inline unsigned ph_real_bits(ph_truth c) {
    unsigned found = 0;
    for (int l = 0; l < PH_WIDTH; l++)
        found |= (unsigned)(c[l] != 0) << l;
    return found;
}

static inline ph_truth ph_real_truth(unsigned runs) {
    ph_truth c;
    for (int l = 0; l < PH_WIDTH; l++)
        c[l] = runs >> l & 1 ? -1 : 0;
    return c;
}
#define PH_BITS(c) ph_real_bits(c) /* bit l: it is true of run l */
#define PH_TRUTH(bits) ph_real_truth(bits)
#else
typedef double ph_real;
typedef int ph_truth;
#define PH_REAL_WHERE(c, a, b) ((c) ? (a) : (b))
#define PH_REAL_ABS(a) fabs(a)
#define PH_REAL_SPREAD(a) (a)
#define PH_NOT(c) (!(c))
#define PH_TRUE 1
#define PH_RUNS 1
#define PH_RUN(a, l) (a)
#define PH_REAL_SQRT(a) sqrt(a)
#define PH_BITS(c) ((c) ? 1U : 0U)
#define PH_TRUTH(bits) ((ph_truth)(bits))
#endif

#endif
