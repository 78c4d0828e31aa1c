/* Steps that keep a tolerance, in compiled code: the twin of phfmu/runs/march/adaptive.py.
 *
 * The Python side reads limits and field lists from here: one field a line. */
#ifndef PH_MARCH_H
#define PH_MARCH_H

#include "modes.h"

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

/* After so many steps in a row that ended on events a step is landed whole, with all of its events, so that
 * those that pile up come to rest. */
#define PH_CROWD 3

/* A span with guards begins where there is room for so many rows and events. */
#define PH_ROOM 8

/* Beside those of ph_status: the smallest step misses the tolerance; the present mode has a larger state than
 * there is room for. */
#define PH_MISSED -1
#define PH_SMALL -2

/* A span is taken by the instance in `parts` equal steps, which are those that are accepted, and by the
 * companion in one. Fields of a march without guards are NULL or 0 from `landing` to `nside`. */
typedef struct ph_march {
    ph_instance *in;        /* NULL with switches: that of the present mode */
    ph_instance *companion; /* as `in` */
    ph_landing *landing;    /* of the guards of `in` */
    ph_modes *modes;        /* of the instance that has switches, */
    ph_modes *others;       /* and of its companion */
    signed char *sides;     /* nside: those of `modes`, */
    signed char *beside;    /* of `others`, */
    signed char *kept;      /* and those at the start of a step */
    int nside;
    int nguard; /* widths of the rows of events: guards, */
    int ncomp;
    int nsignal; /* and signals */
    int pauses;  /* 1: returns after a step with events */
    int parts;
    int nx;
    int order;
    double share; /* of the difference of both solutions that is the error */
    double rtol;
    double atol;
    double min_step; /* of a span, as are all of its sizes */
    double max_step;
    const double *nominal; /* nx */
    double *before;        /* nx: states at the start of a step */
    double *state;         /* all of the instance there, */
    int room;              /* doubles that it may have */
    double *ends;          /* when each accepted step ends, out; not with guards */
    double t;              /* in and out, as are the next seven */
    double h;              /* the proposal */
    double last;           /* error of the last accepted step */
    double smallest;       /* step */
    double largest;
    int rejected;
    int crowd;      /* spans in a row that ended on events */
    int unfinished; /* there was no room for the rest of a span with its events: 1, or 2 if it ends on the
                       next */
    double end;     /* of that span */
    double spent;   /* iterations of the last accepted step, with all of its trials, out */
    int estimator;  /* 1: the companion refused a step, out */
    double size;    /* of a span that was refused or missed the tolerance, out */
    double error;   /* by how much, out */
    int worst;      /* in which state, out */
} ph_march;

/* Times that are landed on, in order; not beyond the last one. */
typedef struct ph_goals {
    const double *t; /* n */
    int n;
} ph_goals;

/* Accepted steps from m->t, at most `room`, which is `parts` at least; *done: how many. PH_OK, PH_MISSED,
 * PH_SMALL, or why a step as short as allowed is refused: then the instance is where the last accepted step
 * ended. */
PH_API int ph_march_steps(ph_march *m, const ph_record *record, const ph_goals *goals, int room, int *done);
/* The same with guards: steps end on their zeros too. out, changed: as those of ph_modes_land; one step with
 * its events may have as many rows and events as there is room for, and goes on in the next call. */
PH_API int ph_march_landed(ph_march *m, const ph_record *record, const ph_goals *goals, ph_landed *out,
                           signed char *changed);

#endif
