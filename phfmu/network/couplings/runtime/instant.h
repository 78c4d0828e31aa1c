/* Unknowns of the junctions at one instant. */
#ifndef PH_INSTANT_H
#define PH_INSTANT_H

#include "in_turn.h"
#include "master.h"

/* Before a step: all shares have to be asked. */
void ph_instant_begin(ph_master *m);
/* A share has to be asked again, since it has moved or its inputs may be others. */
void ph_instant_ask(ph_in_turn *t, int share);
/* Inputs of a share from now on, nu. */
int ph_instant_give(ph_master *m, int share, const double *u);
/* Factors of the matrix as its numbers are, block by block. */
int ph_instant_factor(ph_master *m);
/* z where the members are, which then have it as inputs. */
int ph_instant_solve(ph_master *m);

#endif
