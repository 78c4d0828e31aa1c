/* Derivatives of a run backwards: what a measure of the run takes from its states, parameters and inputs.
 *
 * A bar is the derivative of a measure by the value below it. A step R(x, w, u, p, h) = 0, x+ = x + U w, what
 * it tells T(x, w, u, p, h), takes the bars of x+ and T to those of x, u and p,
 *
 *     A^T l = U^T x+_bar + T_w^T T_bar,   A = R_w,
 *     (x, u, p, h)_bar += T_(x,u,p,h)^T T_bar - R_(x,u,p,h)^T l,   x_bar += x+_bar,
 *
 * one transposed solve and products with kernels in reverse, whatever the number of parameters. */
#ifndef PH_REVERSE_H
#define PH_REVERSE_H

#include "schur_back.h"
#include "system.h"

/* A row of a tape: t, h, the states at the start, the unknowns, the inputs at the nodes. A part that begins
 * where an earlier one did, or before, takes its place: that one was taken back. */
PH_API int ph_tape_width(const ph_model *model);
/* Parts of steps of the instance go to the tape from now on; NULL: no longer. */
PH_API void ph_tape_on(ph_instance *in, ph_tape *tape, double *rows, int room);

/* Lengths of the bars of one measure, one after the other. */
typedef struct ph_bars {
    double *x;     /* nx+1: states and time */
    double *p;     /* np */
    double *u;     /* nu: held inputs */
    double *pairs; /* nq: energies through pairs since the start */
    double *lost;  /* ncomp: dissipated energies since the start */
    double *h;     /* 1: the length of steps that moves */
} ph_bars;

/* Bars of what a row of a run tells, for one measure: [x nx | a na | y_step nq | energy nq | dissipated
 * ncomp]; of what holds at its end: [a_end na | y_end nq | observables nobs | H ncomp]. */
typedef struct ph_row_bars {
    int n;             /* rows that have some */
    const int *row;    /* n: their numbers, ascending */
    const double *bar; /* n x measures x width */
} ph_row_bars;

/* Rows of a tape, all with the parameters of the instance. */
typedef struct ph_parts {
    int n;
    const double *rows; /* n x width */
    const int *row;     /* n: the row of the run that each part belongs to */
    const double *part; /* n: what it is of that row's step */
    int moves; /* 1: they are of one step whose start and length move, so that their bars are wanted */
} ph_parts;

typedef struct ph_reverse ph_reverse;

/* Functions of a model: of each kernel of the code, and of its ledger, (x, y, p, bar of the results) -> bars
 * of x, y and p; the way back of the Schur stepper, or NULL. */
typedef struct ph_backwards {
    const ph_function *kernels, *ledgers;
    const ph_schur_back *schur;
} ph_backwards;

/* n measures at once. The instance is its own: what is in it changes. */
PH_API size_t ph_reverse_size(const ph_instance *in, const ph_backwards *functions, int n);
PH_API ph_reverse *ph_reverse_init(void *memory, ph_instance *in, const ph_backwards *functions, int n);
PH_API int ph_reverse_width(const ph_model *model);
/* n x ph_reverse_width, the bars in the order of ph_bars: to be set before, and read after. */
PH_API double *ph_reverse_bars(ph_reverse *r);
/* Parts of steps, of each measure, that went back by the factor of the Schur stepper. */
PH_API int ph_reverse_by_schur(const ph_reverse *r);
/* Back over parts of steps, from the last one; *at: the start of one that has no derivative. */
PH_API int ph_reverse_steps(ph_reverse *r, const ph_parts *parts, const ph_row_bars *told, double *at);
/* The way back from values at the present time of the instance: `bar` n x (na + nq + nobs + ncomp). */
PH_API int ph_reverse_instant(ph_reverse *r, const double *bar);

#endif
