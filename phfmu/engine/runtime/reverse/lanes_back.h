/* Lanes on the way back over a step: the values at its solution and the bars that a sweep goes over. */
#ifndef PH_LANES_BACK_H
#define PH_LANES_BACK_H

#include "lanes.h"
#include "schur_back.h"

/* Arguments and results of a loop over instances; lengths as in ph_work. */
typedef struct ph_back_sweep {
    const ph_schur *c;
    double h;
    const double *parameters, *point, *start;
    const ph_lane *input, *multiplier, *x, *f, *v;
    ph_lane *slot;            /* gradients of the rows */
    ph_lane *stress;          /* nstrain */
    ph_lane *level;           /* nstrain: C at the nodes, of stresses that are numbers its increments */
    ph_lane *share;           /* ndof+1: z, bars of the forces */
    ph_lane *shift;           /* ndof+1: m, bars of the shifts */
    ph_lane *rho;             /* nconstraint: bars of G F = 0 */
    ph_lane *at;              /* ndof+1: bars of the displacements */
    ph_lane *by;              /* ndof+1: bars of F */
    ph_lane *turn;            /* ndof+1: H z */
    ph_lane *row;             /* nconstraint: -G z, and in the last lane -sum (G m - K z) */
    double *slope;            /* nstrain: phi'' */
    double *starts;           /* nstrain: bars of C at the start */
    double *masses;           /* ndof: bars of m */
    double *p, *u;            /* bars of parameters and held inputs, which are added */
    ph_lane column[PH_K];     /* h A with h b below it, by columns */
    ph_lane across[PH_LANES]; /* by rows */
} ph_back_sweep;

#endif
