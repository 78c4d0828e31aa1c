/* Steps of PH_WIDTH runs of one model at a time, each number of the runtime being a vector with one of each:
 * the plain way of a step, Newton's method from the last step with the pivots that there are. A run that
 * anything unusual happens to is left out, and its numbers stay. */
#ifndef PH_WIDE_H
#define PH_WIDE_H

#include "lane_width.h"
#include "system.h"

typedef struct ph_wide ph_wide;

/* Bytes for runs of `model` with the kernels of `code`, all of them interpreted by ph_wide_interpret_*, and
 * with its solver, which is compiled for so many runs: with one they have no other way to solve a step. */
size_t ph_wide_size(const ph_model *model, const ph_code *code);
/* Begin in memory of so many bytes, aligned for double. */
ph_wide *ph_wide_init(void *memory, const ph_model *model, const ph_code *code);
/* The arrays of ph_state_arrays, in whose rows of PH_LANE_WIDTH number l belongs to run l. */
const ph_array *ph_wide_arrays(const ph_wide *w);
/* Pivots (nw), the last step size and whether inputs are held from now on; PH_OK, or no steps with these. */
int ph_wide_prepare(ph_wide *w, const int *pivot, double last_h, int held);
/* The matrix [nnz] of the factor that run l has kept, to be taken over with the next step. */
void ph_wide_recall(ph_wide *w, int l, const double *kept);
/* The matrices that runs have kept, in rows as ph_wide_arrays. */
ph_array ph_wide_kept(const ph_wide *w);

/* The cost of a step of each run. */
typedef struct ph_wide_cost {
    int iterations[PH_LANE_WIDTH];
    unsigned factored; /* runs with a factor of another matrix than before */
} ph_wide_cost;

/* Solves a step of the runs whose bits are in `wanted`, the `trusting` ones from the factors that they have
 * kept; those that did it, of which nothing moves yet. */
unsigned ph_wide_solve(ph_wide *w, double t, double h, unsigned wanted, unsigned trusting,
                       ph_wide_cost *cost);
/* Takes the step that was solved; numbers of the others are not to be used any more. */
void ph_wide_accept(ph_wide *w, double t, double h);

#endif
