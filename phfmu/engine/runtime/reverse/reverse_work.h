/* The way back of one instance, with its work space. */
#ifndef PH_REVERSE_WORK_H
#define PH_REVERSE_WORK_H

#include "reverse.h"

struct ph_reverse {
    ph_instance *in;
    const ph_function *kernels, *ledgers;
    const ph_schur_back *fast; /* or NULL */
    void *schur;               /* its work space */
    int quick;                 /* 1: it has the equations of the present part */
    int by_schur;              /* parts that went back by it */
    double h;                  /* of the present part */
    int n;                     /* measures */
    double *bars;              /* n x ph_reverse_width */
    double *x;                 /* nx+1+na: the states at the start of a part */

    double *xb;     /* nx+1+na: bars of one system, as are the next two */
    double *yb;     /* nv+nz */
    double *rb;     /* nrow */
    double *b;      /* nw: right-hand side of the transposed solve */
    double *lambda; /* nw: its solution */
    double *rest;   /* nw: what it misses */
    double *more;   /* nw: a correction */
    double *lost;   /* ncomp: bars of the rates of loss */
    double *slope;  /* nz+nrow: derivatives of Z and of the rows by h alone */

    double *bar;   /* of the results of one kernel */
    double *local; /* its arguments and their bars */
    double *work;  /* of one kernel, as are the next three */
    int *iw;
    const double **arg;
    double **res;
};

/* Bars of rows, Y and x: none. */
void ph_back_clear(ph_reverse *r, const ph_system *s);
/* The bars rb of the rows, yb of what is read of Y besides, and of energies by component (NULL: none) to
 * those of x, Y and p. The values are those that were evaluated last. */
void ph_back(ph_reverse *r, ph_system *s, const double *stored, const double *lost, double *pb);
/* The bar of h in what ph_back has gone back over last. */
double ph_back_length(ph_reverse *r, const ph_system *s);
/* lambda = A^-T b with the factor at hand, refined; PH_SINGULAR where that does not settle. */
int ph_back_solve(ph_reverse *r, ph_system *s);

#endif
