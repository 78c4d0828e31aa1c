/* The work space of changes of modes, shared by the files of this folder. */
#ifndef PH_MODES_WORK_H
#define PH_MODES_WORK_H

#include "mode_limits.h"
#include "modes.h"
#include "system.h"

struct ph_modes {
    const ph_switches *sw;
    const ph_mode_source *source;
    signed char *started, *on, *asked; /* the caller's */
    const ph_mode *present;
    const ph_mode *entered; /* that is being entered, else NULL */
    ph_mode_refusal refusal;
    double t0, grid, step; /* of the grid of steps; how long they are where it has no length */
    double until;          /* the end of the only grid step, else NAN */
    int first, n, changed; /* of them */
    int pending;           /* 1: the grid is not begun yet */
    /* of a change */
    double t;
    double *x, *a, *u;    /* nx, na, nu: before it */
    double *p;            /* np: after it */
    double *there;        /* nx: after the impulses of the old mode */
    double *then;         /* nx: and those of the new one */
    double *moved;        /* ncomp: energies that they gave, */
    double *left;         /* ncomp: of them those of the old mode */
    signed char *want;    /* n: proposal */
    signed char *fixed;   /* n: switches that are not asked */
    signed char *tried;   /* n */
    signed char *which;   /* n: of a refusal */
    int *asked_of, *flip; /* n: switches that are asked, places of those that change */
    /* of an instant: values of the kernels, and of the equations */
    double *work;           /* of kernels */
    double *xt, *y;         /* nx+1, na+nu */
    double *rates;          /* nresult */
    double *before, *after; /* ncomp*nx */
    double *matrix, *right; /* (nx+na)^2, nx+na */
    double *kept;           /* na*na */
    double *basis;          /* na*na: columns of N */
    double *moves;          /* na*nx: columns of L */
    double *found;          /* nx+na */
    double *scaling;        /* nx+na */
    int *rows, *columns;    /* nx+na */
};

/* Places of the results of the rates in m->rates; matrices by columns. */
typedef struct ph_rates {
    const double *f, *fx, *fa, *g, *gx, *ga, *c, *cx, *ca, *gap, *mass;
} ph_rates;

/* mode_rates.c: at the states x, m->a, m->u, the parameters p, the time t. */
ph_rates ph_mode_rates(ph_modes *m, const double *x, const double *p, double t);
/* The states after the impulses that the mode in p asks for, from x, into `to`; by component the energy that
 * they give; 1 if there are impulses. */
int ph_mode_enter(ph_modes *m, const double *x, const double *p, double *to, double *energy);
/* mode_choice.c: the mode nearest to m->want that obeys the laws, from the states x, into m->tried; 0: none.
 */
int ph_mode_select(ph_modes *m, const double *x, double h);
/* modes.c: takes the parameters p, with the modes `asked` if there are some, and the mode that follows; h:
 * step of the run. Adds to energy and lost (ncomp each); changed (n): 1 = went off, 2 = on. */
int ph_mode_change(ph_modes *m, const double *p, const signed char *asked, double h, double *energy,
                   double *lost, signed char *changed);
/* mode_dense.c: y with A y = b, A (n*n by rows, destroyed), the right side too; pivots not above `least` are
 * none, and their unknowns 0. rows, columns: n each. The rank. */
int ph_dense_solve(int n, double *a, double *b, double least, double *y, int *rows, int *columns);
/* Columns of a basis of the null space of A (rows*n by rows, destroyed), one after the other; how many. */
int ph_dense_null(int n, double *a, double least, double *basis, int *rows, int *columns);

#endif
