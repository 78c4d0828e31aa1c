/* The work space of a landing, shared by the files of this folder. */
#ifndef PH_EVENT_LANDING_H
#define PH_EVENT_LANDING_H

#include "events.h"
#include "system.h"

struct ph_landing {
    ph_instance *in;
    const ph_events *events;
    const ph_lent_steps *lent; /* the caller's, or NULL: the instance takes its own steps */
    double t0, grid;           /* of the grid of steps */
    long long k, end;          /* the grid step under way, and the first that is not to be taken */
    int changed, under_way;
    double t, stop; /* where it is, and where the grid step ends */
    double until;   /* the end of the only grid step, else NAN */
    double h;       /* of the trial */
    int happened;   /* events in this grid step */
    int passes;     /* of them at this instant */
    int nfired;     /* flags in fired */
    long long counted[2];
    ph_event_refusal refusal;
    const signed char *stops; /* n: events that happen elsewhere, or NULL; the caller's */
    int stopped;              /* 1: at one of them */
    double *last;             /* n: when each event of the grid step happened last */
    double *rates;            /* n: how fast each guard moved where the present instant was reached */
    double *moved;            /* n: largest mean rate of each guard between two points of the trial */
    double *start, *now;      /* n: guards at the start of the step, and at its end */
    double *slopes;           /* 2*n: d guard / dt there, 0 where it is not known */
    double *values;           /* npoint*n: guards over the trial */
    double *fits;             /* n*npoint: Bernstein coefficients */
    double *x, *start_x;      /* nx+1 */
    double *w;                /* nw: unknowns of the trial */
    double *y;                /* na+nu */
    double *p;                /* np */
    double *jump;             /* results of the jump kernel */
    double *c, *before_c;     /* ncomponent*ncolumn: of the jumps that happen and the constraints */
    double *s, *factor;       /* ncolumn*ncolumn */
    double *goal, *m, *found; /* ncolumn */
    double *e;                /* ncolumn */
    signed char *acts;        /* ncolumn: 1 = has an impulse */
    int *which;               /* ncolumn: the jumps that happen, then the constraints, */
    int *whose;               /* njump: and the events of the jumps */
    signed char *fired, *rests, *looked, *from_zero, *refused; /* n */
    void *before, *after;                                      /* states of the instance */
    /* of a communication step that is told as one */
    double told_from, told_until;
    int told;     /* 1: a step of it was taken */
    double *kept; /* ph_kept_size */
    void *begun;  /* state of the instance at its start */
};

static inline double ph_larger(double a, double b) {
    return a > b ? a : b;
}

/* One accepted step from l->t, at most h long: its length (0: none was taken); events at its end are in
 * l->fired. */
int ph_locate(ph_landing *l, double h, double *length);
/* event_guards.c: guards at x (nx+1) with l->y; l->y = [a | u] now; guards now. */
void ph_guards_at(const ph_landing *l, const double *x, double *g);
/* d guard / dt now, with l->y as it was read last. */
void ph_guard_slopes(const ph_landing *l, double *slopes);
int ph_read_guarded(ph_landing *l);
int ph_guard_values(ph_landing *l, double *g);
int ph_armed(const ph_landing *l, int i);
/* The value below which guard i, which changes at `rate` (1/s), is zero at time t. */
double ph_zero_below(const ph_landing *l, int i, double t, double rate);
/* The value that guard i may have now if it was zero where this instant was reached. */
double ph_rounded(const ph_landing *l, int i);
/* An instant is reached at the rates l->moved. */
void ph_arrive(ph_landing *l);
int ph_fits_direction(const ph_landing *l, int i, double rate);
/* Events that set modes and are beyond zero, into l->fired. */
int ph_already(ph_landing *l);
/* event_trial.c: the same where a step of at most h begins after something was set: the time itself is
 * rounded there, so that a guard may be beyond zero by what it moves in that; a trial tells. */
int ph_begun(ph_landing *l, double h);
/* event_trial.c: a step of length h from l->t; here is where trials begin, and back to there. */
int ph_trial_step(ph_landing *l, double h);
void ph_trial_begin(ph_landing *l);
void ph_trial_back(ph_landing *l);
/* event_trial.c: takes a step of length l->h at most from l->start_x, and looks at the guards over it. */
int ph_look(ph_landing *l);
/* event_trial.c: takes a step of length l->h at most; *leaves: how many guards happen at once, and none is
 * taken. */
int ph_try_step(ph_landing *l, int *leaves);
/* event_trial.c: x, the states at the start of a step with k nodes and the unknowns w, becomes those at point
 * m of the fit. */
void ph_events_inside(const ph_events *e, int k, int m, const double *w, double *x);
/* d guard / dt at the fraction tau of the trial; the first zero of a guard in it that is not refused, or -1;
 * with the slope 0 it is a guard that turns back, where steps have to tell. */
double ph_guard_rate(const ph_landing *l, int i, double tau);
int ph_first_zero(const ph_landing *l, const signed char *refused, ph_crossing *best);
int ph_happen(ph_landing *l, ph_landed *out);
/* event_impulse.c: the jumps of the events in l->fired at the parameters l->p after them; what it adds to the
 * energy of each component and what is lost. */
int ph_jump_event(ph_landing *l, double *energy, double *lost);
int ph_refuse_event(ph_landing *l, int reason, double value, double limit);

#endif
