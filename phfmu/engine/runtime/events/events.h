/* State events of an instance: steps that end on the zeros of guards, jumps of the states.
 *
 * docs/understand/events.md has the rules.
 * Nothing of an instance knows of it. */
#ifndef PH_EVENTS_H
#define PH_EVENTS_H

#include "event_limits.h"
#include "phfmu.h"

#define PH_MOST_POINTS 16

/* Mirror of EventPlan; all tables are constant. Rows of the guards are their numbers, their x is [states |
 * time], their Y [algebraic variables | inputs]. */
typedef struct ph_events {
    int n;                    /* state events, with a guard each */
    int ngroup;               /* groups of guard kernels */
    int nrate;                /* groups of the kernels of their rates */
    int solves;               /* 1: a guard reads algebraic variables */
    int npoint;               /* 2k+2 points of the fit */
    int nincrement, nstart;   /* entries of the polynomial */
    int njump, ncolumn;       /* jumps; their columns and those of the constraints that hold through them */
    int nmoved, ncomponent;   /* the states they move, the components whose energy they change */
    const ph_group *groups;   /* ngroup */
    const ph_group *rates;    /* nrate: d guard / dt of those that are rated */
    const signed char *rated; /* n */
    const ph_group *jump;     /* c by component | L by column | S | e of the jumps; NULL: none */
    const signed char *direction; /* n */
    const double *nominal;        /* n */
    const int *owner;             /* n: component that its loss is booked at */
    const int *when_ptr;          /* n+1: armed while the parameters have these values */
    const int *when_p;
    const double *when_value;
    const int *sets_ptr; /* n+1: what it sets */
    const int *sets_p;
    const double *sets_value;
    const int *rest_ptr; /* n+1: what it sets besides where events pile up */
    const int *rest_p;
    const double *rest_value;
    const int *jump_of;                /* n: its jump, or -1 */
    const int *jump_moved;             /* nmoved */
    const int *jump_component;         /* ncomponent */
    const double *jump_most;           /* njump: largest |c| */
    const signed char *jump_pushes;    /* njump: 1 = its impulse is not negative */
    const int *polynomial_state;       /* nincrement: each increment with its state, */
    const int *polynomial_w;           /* its place among the unknowns */
    const int *polynomial_node;        /* and its node */
    const int *polynomial_start_state; /* nstart: impulses at the start of a step */
    const int *polynomial_start_w;
    const double *fit_tau;     /* npoint */
    const double *fit_weights; /* npoint*k: integrals of the Lagrange basis up to tau */
    const double *fit_whole;   /* npoint*npoint: values at tau to Bernstein coefficients */
    const double *fit_divided; /* (npoint-1)^2: the same of values / tau behind 0 */
} ph_events;

/* Memory of the caller for steps and events, with room for so many. */
typedef struct ph_landed {
    int steps_room, events_room;
    int pause;                /* 1: returns before the first step behind an event */
    int steps, events;        /* written by the last call */
    int done;                 /* 1: all grid steps are taken */
    double *t;                /* steps: starts */
    double *h;                /* steps: sizes */
    double *event_t;          /* events */
    int *event_step;          /* events: steps written before it */
    signed char *event_fired; /* events*n: 1 = happened, 2 = and came to rest */
    double *event_energy;     /* events*ncomp: by a jump */
    double *event_lost;       /* events*ncomp */
    double *event_signals;    /* events*length of the signal table: after it */
} ph_landed;

/* Why PH_EVENT, in the order of REASONS in event_failure.py. */
typedef enum ph_event_reason {
    PH_REFUSED_DEPENDENT,
    PH_REFUSED_MOST,
    PH_REFUSED_GAIN,
    PH_REFUSED_PILE,
    PH_REFUSED_AGAIN,
    PH_REFUSED_SLIDES
} ph_event_reason;

typedef struct ph_event_refusal {
    int reason;
    double t, value, limit;
    const signed char *fired; /* n */
} ph_event_refusal;

typedef struct ph_landing ph_landing;

/* Bytes for the landing of an instance; memory: so many, aligned for double, owned by the caller. */
PH_API size_t ph_landing_size(const ph_instance *in, const ph_events *events);
PH_API ph_landing *ph_landing_init(void *memory, ph_instance *in, const ph_events *events);
/* Steps that others take for the instance of a landing: coupled members, whose states together are its own.
 * step: one of them, after which the instance has the states at its end; a ph_status. halved: how many so far
 * were taken in parts. inside: x (nx), the states at the start of the last one, becomes those at its fraction
 * tau. save, load: of where the others are. */
typedef struct ph_lent_steps {
    void *world;
    int (*step)(void *world, double t, double h);
    long long (*halved)(void *world);
    void (*inside)(void *world, double tau, double *x);
    void (*save)(void *world);
    void (*load)(void *world);
} ph_lent_steps;

PH_API void ph_land_lent(ph_landing *l, const ph_lent_steps *steps);
/* Grid steps first..first+n-1 from t0 + k h are to be taken; changed: values were set since the last step. */
PH_API void ph_land_from(ph_landing *l, double t0, double h, int first, int n, int changed);
/* One grid step, from t to `end`, after those before it: what was landed on still counts. */
PH_API void ph_land_to(ph_landing *l, double t, double end, int changed);
/* Takes them, until all are taken or there is no more room; again goes on. record: a row a step. After a
 * status other than PH_OK the instance is at the last step written. */
PH_API int ph_land(ph_landing *l, const ph_record *record, ph_landed *out);
PH_API int ph_land_more(ph_landing *l, const ph_record *record, ph_landed *out); /* behind what is in out */
/* A communication step [t, t+h], h >= 0, of n equal grid steps under held inputs, told as one: rows of the
 * ledger, means and outputs at nodes are those of the whole, and have no derivative if an event is in it. */
PH_API int ph_land_begin(ph_landing *l, double t, double h, int n);
/* On to the next event of it, which is written to out (events 1), or to its end (done); again goes on. After
 * a status other than PH_OK the instance is where the step began. */
PH_API int ph_land_on(ph_landing *l, ph_landed *out);
/* Events with 1 in `stops` (n; the caller's, which outlives the landing) happen elsewhere: ph_land ends
 * before them. */
PH_API void ph_land_stops(ph_landing *l, const signed char *stops);
/* The events (n) it ended before, their time and their number in the grid step; NULL if it did not. */
PH_API const signed char *ph_land_stopped(const ph_landing *l, double *t, int *happened);
/* Goes on after them where `from`, of a model with the same events, perhaps l itself, ended. */
PH_API int ph_land_after(ph_landing *l, const ph_landing *from);
/* |d guard / dt| (n) where the present instant was reached, by which a guard that was landed on is zero. */
PH_API double *ph_land_rates(const ph_landing *l);
/* Which of those events come to rest, and the parameters after them (np), which wait for who sets them. */
PH_API int ph_happen_decide(ph_landing *l);
/* The first half of those events: decided, and the states jump; energy and lost (ncomp each) are overwritten.
 * After a status other than PH_OK, and after undo, the instance is where it was. */
PH_API int ph_happen_jump(ph_landing *l, double *energy, double *lost);
PH_API void ph_happen_undo(ph_landing *l);
PH_API const double *ph_happen_parameters(const ph_landing *l);
PH_API void ph_happen_flags(const ph_landing *l,
                            signed char *fired); /* n: 1 = happens, 2 = and comes to rest */
/* After events in a communication step: its means are those of the whole again. */
PH_API void ph_land_tell(ph_landing *l);
PH_API const ph_event_refusal *ph_land_refusal(const ph_landing *l);

/* event_roots.c: b, Bernstein coefficients of degree n. */
typedef struct ph_crossing {
    double tau, slope;
} ph_crossing;

double ph_bernstein(const double *b, int n, double t);
double ph_bernstein_slope(const double *b, int n, double t, int from_zero);
int ph_first_crossing(const double *b, int n, int direction, int from_zero, ph_crossing *at);
/* 1 if a guard turns back that may have been zero, and the fraction tau of the step where: values and slopes
 * d guard / d tau at its ends. */
int ph_turns(double start, double end, double slope_start, double slope_end, double *tau);
/* The place where the parabola through three points (x, y) is least; the middle one where it is not curved
 * upwards. */
double ph_vertex(const double left[2], const double middle[2], const double right[2]);

#endif
