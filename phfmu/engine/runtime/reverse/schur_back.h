/* The way back over steps of constrained particles by the factor of the Schur stepper (schur_back.inc). */
#ifndef PH_SCHUR_BACK_H
#define PH_SCHUR_BACK_H

#include "plan.h"

/* Compiled for the lanes of one model; size is NULL where there is none. init lays its work space for n
 * measures out in memory of size(plan, n) bytes aligned for double. begin: the equations at x, w, u and p of
 * a system, for a step of length h; PH_OK, or a status that says another factor has to serve. back: from bars
 * b (nw) of the unknowns, for one measure, through the solution of the equations to those of x (nx), u (nu,
 * held) and p, which are added; PH_OK, or the same, and nothing is added. */
struct ph_system;
typedef struct ph_schur_back {
    size_t (*size)(const struct ph_plan *plan, int n);
    void (*init)(void *memory, const struct ph_plan *plan, int n);
    int (*begin)(void *memory, const struct ph_system *system, double h);
    int (*back)(void *memory, int measure, const double *b, double *x, double *u, double *p);
} ph_schur_back;

#endif
