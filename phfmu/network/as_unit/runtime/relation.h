/* A member that is ideal switches and nothing else: members/relation.py in C.
 *
 *     0 = J(s) a + B(s) u,    y = B(s)^T a,
 *
 * s the modes. It takes no power and has no steps of its own: its unknowns a are among those of the
 * junctions, at nodes, where its inputs are [u | a] and its outputs [y | 0]. At instants it is told them. */
#ifndef PH_RELATION_H
#define PH_RELATION_H

#include "network.h"

typedef struct ph_relation {
    int nu; /* as many as pairs */
    int na;
    int np;
    int nobs;
    int ncomp;
    int k;
    int n;                 /* switches */
    const double *weights; /* k */
    const int *place;      /* n: parameters that are their modes */
    const double *B;       /* 2^n*na*nu: of mode number sum 2^j s_j */
    const double *p;       /* np: at the start, as the unknowns */
    const double *a;       /* na */
    const int *at;         /* na: unknowns among the algebraic variables of the composed model, */
    const int *observed;   /* nobs: and its values among the observables of that */
} ph_relation;

const ph_step_map *ph_map_relation(void);
const ph_kind *ph_kind_relation(void);
/* Its values at the time t: algebraic variables and observables of the composed model. */
void ph_relation_tell(void *of, double t, const double *a, const double *observables);
/* Its unknowns at the last instant that it was told of. */
const double *ph_relation_unknowns(const void *of);
void ph_relation_clear(void *of); /* the ledger of the step */

#endif
