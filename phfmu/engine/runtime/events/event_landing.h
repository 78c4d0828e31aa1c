/* The work space of a landing, shared by events.c, event_locate.c and event_jump.c. */
#ifndef PH_EVENT_LANDING_H
#define PH_EVENT_LANDING_H

#include "events.h"
#include "system.h"

struct ph_landing {
    ph_instance *in;
    const ph_events *events;
    double t0, grid;  /* of the grid of steps */
    long long k, end; /* the grid step under way, and the first that is not to be taken */
    int changed, under_way;
    double t, stop; /* where it is, and where the grid step ends */
    double h;       /* of the trial */
    int happened;   /* events in this grid step */
    int passes;     /* of them at this instant */
    int nfired;     /* flags in fired */
    long long counted[2];
    ph_event_refusal refusal;
    double *last;             /* n: when each event of the grid step happened last */
    double *start, *now;      /* n: guards at the start of the step, and at its end */
    double *values;           /* npoint*n: guards over the trial */
    double *fits;             /* n*npoint: Bernstein coefficients */
    double *x, *start_x;      /* nx+1 */
    double *w;                /* nw: unknowns of the trial */
    double *y;                /* na+nu */
    double *p;                /* np */
    double *jump;             /* results of the jump kernel */
    double *c, *before_c;     /* ncomponent*njump: of the jumps that happen */
    double *s, *factor;       /* njump*njump */
    double *goal, *m, *found; /* njump */
    double *e;                /* njump */
    int *which;               /* njump: the jumps that happen, */
    int *whose;               /* njump: and their events */
    signed char *fired, *rests, *looked, *from_zero, *refused; /* n */
    void *before, *after;                                      /* states of the instance */
};

static inline double ph_larger(double a, double b) {
    return a > b ? a : b;
}

/* One accepted step from l->t, at most h long: its length (0: none was taken); events at its end are in
 * l->fired. */
int ph_locate(ph_landing *l, double h, double *length);
int ph_guard_values(ph_landing *l, double *g);
int ph_already(ph_landing *l);
int ph_happen(ph_landing *l, ph_landed *out);
int ph_refuse_event(ph_landing *l, int reason, double value, double limit);

#endif
