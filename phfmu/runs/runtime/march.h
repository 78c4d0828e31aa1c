/* Steps that keep a tolerance, in compiled code: the twin of phfmu/runs/adaptive.py.
 *
 * The Python side reads limits and field lists from here: one field a line. */
#ifndef PH_MARCH_H
#define PH_MARCH_H

#include "phfmu.h"

/* A part of the proposed size, limits of its change from step to step, exponents of the PI controller times
 * 1/(order of the estimate), and what an error counts for at least. */
#define PH_SAFETY 0.9
#define PH_SHRINK 0.2
#define PH_GROW 5.0
#define PH_INTEGRAL 0.7
#define PH_PROPORTIONAL 0.4
#define PH_LEAST_ERROR 1e-10

/* Binary digits of a step size: engines that agree to rounding take the same steps. */
#define PH_DIGITS 8

/* A step below this part of the time is lost in it; where the time is 0, one below so many seconds. */
#define PH_LOST 1e-14
#define PH_TINY 1e-15

/* What is left up to a goal is one step if the proposal misses it by less than this part. */
#define PH_NEAR 1e-9

/* Beside those of ph_status: the smallest step misses the tolerance. */
#define PH_MISSED -1

typedef struct ph_march {
    ph_instance *in;
    ph_instance *companion;
    int nx;
    int order;
    int exactly; /* 1: steps are taken however short they are, and not recorded */
    double rtol;
    double atol;
    double min_step;
    double max_step;
    const double *nominal; /* nx */
    double *before;        /* nx: states at the start of a step */
    double *state;         /* all of the instance there */
    double *ends;          /* room: when each accepted step ends, out */
    double t;              /* in and out, as are the next five */
    double h;              /* the proposal */
    double last;           /* error of the last accepted step */
    double smallest;
    double largest;
    int rejected;
    double spent;  /* iterations of the last accepted step, with all of its trials, out */
    int estimator; /* 1: the companion refused a step, out */
    double size;   /* of a step that was refused or missed the tolerance, out */
    double error;  /* by how much, out */
    int worst;     /* in which state, out */
} ph_march;

/* Accepted steps from m->t, not beyond the goal, at most `room`; *done: how many. PH_OK, PH_MISSED, or why a
 * step as short as allowed is refused: then the instance is where the last accepted step ended. */
PH_API int ph_march_steps(ph_march *m, const ph_record *record, double goal, int room, int *done);

#endif
