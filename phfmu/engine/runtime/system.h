/* Internals of the runtime: sparse factorisation, one nonlinear system, one instance. */
#ifndef PH_SYSTEM_H
#define PH_SYSTEM_H

#include "phfmu.h"
#include "pool.h"

/* Sparse LU of a matrix in CSC form with fixed column order. Step j eliminates column order[j] with
 * row pivot[j]. Column j of the factors is kept at start[j]..start[j+1]: first U (pivot steps, in
 * elimination order), from lower[j] on L (pivot steps of the rows); diagonal as reciprocal. */
typedef struct ph_lu {
    int n, nnz, capacity;
    const int *colptr, *rowind, *order, *prefer;
    int *pivot, *where; /* n each, inverse permutations of each other */
    int *start, *lower; /* n+1, n */
    int *index;         /* capacity */
    ph_real *value;     /* capacity */
    ph_real *inverse;   /* n */
    int *place;         /* nnz: where[rowind] */
    ph_real *work;      /* n, zero between calls */
    int *mark, *stack, *child;
    int failed;       /* column without a pivot */
    int known;        /* pivots and their pattern are those of the last factors */
    int ready;        /* and the next factors are to have them too */
    int filled;       /* the numbers are valid */
    ph_truth refused; /* of several runs: a pivot has become too small */
} ph_lu;

/* Take the arrays of a factor from the pool, by its sizes n, nnz and capacity. */
void ph_lu_take(ph_lu *lu, ph_pool *pool);
int ph_lu_factor(ph_lu *lu, const ph_real *a, long long *count);
int ph_lu_forced(ph_lu *lu, const ph_real *a, double forced);
int ph_lu_refactor(ph_lu *lu, const ph_real *a);
int ph_lu_adopt(ph_lu *lu, const int *pivot);
void ph_lu_solve(ph_lu *lu, const ph_real *b, ph_real *x);
void ph_lu_solve_transposed(ph_lu *lu, const ph_real *b, ph_real *x);

/* One plan with its work space. The first block points into the state of the instance. */
typedef struct ph_system ph_system;
struct ph_system {
    const ph_plan *plan;
    const ph_code *code;
    ph_real *work; /* of kernels */
    const ph_real *x, *p;
    const ph_real *rest; /* nx: what compensated summation still owes x, to be subtracted */
    ph_real *last;       /* nw: last converged unknowns */
    double *last_h;      /* step they belong to, 0 = start values */
    int *pivot;          /* nw, pivots the state remembers; pivot[0] = -1: none */
    ph_real *kept; /* nnz if factors are kept over steps: the A of the factor at the end of the last step */
    int *rests;    /* nhold, one for both systems: PH_RESTS = left out */

    ph_real *y;          /* nv+nz */
    ph_real *r;          /* nrow */
    ph_real *v;          /* nslot */
    ph_real *a;          /* nnz */
    ph_real *factored;   /* nnz: the A in the factor */
    ph_real *scaled;     /* nnz */
    ph_real *scale;      /* nw */
    ph_real *rhs;        /* nw */
    ph_real *dw;         /* nw */
    ph_real *base;       /* nw */
    ph_real *loose;      /* nw if constraints may rest: a solution found with delta, see attempts.c */
    double *fixed;       /* nnz: constant part of A at this h */
    double *products;    /* varying_value h^power */
    double *derivatives; /* derivative_value h^power */
    ph_real *blocks;     /* nderivative */
    double *constants;   /* const_val h^pow */
    ph_real *gap;        /* nhold: what the constraints that rest miss */
    ph_real *spread;     /* 2 nhold k + 4 k: work of ph_rest_spread */
    double hp[3];        /* 1, h, h^2 */
    ph_lu lu;
    int resting; /* constraints left out */
    int bare;    /* 1: factors without delta */
    int holds;   /* the factor is that of `kept` */
    int trusts;  /* Newton's method begins with it */
    int strict;  /* the Schur stepper sweeps until updates are rounding */
    int empty;   /* row without entries at the last factorisation, or -1 */
    int iterations;
    ph_real update;
    long long *count;
    long long most; /* count[PH_ITERATIONS] from which on no attempt begins */
#ifdef PH_WIDTH
    unsigned wanted; /* runs whose step is solved */
#endif
};
#ifdef PH_WIDTH
#define PH_WANTED(s) ((s)->wanted)
#else
#define PH_WANTED(s) 1U
#endif

void ph_eval_h(ph_system *s, double h);
void ph_eval(ph_system *s, int slots, int late);
void ph_eval_late(ph_system *s);
void ph_eval_matrix(ph_system *s);
void ph_eval_derivatives(ph_system *s, ph_real *out);
void ph_eval_ledger(ph_system *s, ph_real *stored, ph_real *moved, ph_real *lost, ph_real *numerical);

typedef enum ph_newton_kind {
    PH_KEPT,   /* begins with the factor of the last step, then as the next one */
    PH_CHORD,  /* keeps its factor while that contracts */
    PH_FRESH,  /* a new matrix every iteration */
    PH_DAMPED, /* that and a line search */
} ph_newton_kind;

int ph_newton(ph_system *s, ph_newton_kind kind);
int ph_solve(ph_system *s, double h);
void ph_newton_bare(ph_system *s, int bare);
int ph_newton_factor(ph_system *s);
int ph_newton_recall(ph_system *s);
void ph_explain(ph_system *s, int status, ph_report *report);

#define PH_SMALLEST (1 << PH_DEPTH) /* smallest substeps of an internal step */

enum { PH_AWAKE, PH_RESTS, PH_CALLED }; /* CALLED: needed again in the step being solved */

void ph_rest_begin(ph_instance *in);
void ph_rest_placed(ph_instance *in);
void ph_rest_choose(ph_instance *in);
int ph_rest_first(const ph_plan *p, int c);
double ph_rest_force(const ph_system *s, int c);
void ph_rest_dependence(ph_system *s, int c);
void ph_rest_tell(ph_instance *in, double time, int rests, int needed);
void ph_rest_continue(ph_instance *in, const ph_instance *from);
void ph_rest_take(ph_instance *in);
void ph_rest_spread(ph_system *s);
void ph_rest_spread_step(ph_instance *in);
void ph_rest_exchange(ph_instance *in, double time);
int ph_rest_wake(ph_instance *in);
void ph_rest_settle(ph_instance *in, double time, int accepted);

/* Counters and switches of the state; doubles and pivots follow it. */
typedef struct ph_head {
    uint64_t token, size;
    double last_h[2]; /* of step and instant system */
    double step_h;    /* length of the last communication step */
    double theta;     /* where in its step a node input is evaluated for the end values */
    int held;         /* inputs are held values */
    int dirty;        /* end values are out of date */
    int parts;        /* substeps of the last communication step, 0 = none yet */
    int changes;      /* of the constraints at rest since the start */
    int kept;         /* the matrix of the last step's factor is kept */
    int unkept;       /* steps until the next one begins with a kept factor */
    int usual;        /* iterations of the last step that did not */
    int served;       /* steps that the kept factor has served */
    int placed;       /* state or parameters are new: which constraints rest has to be chosen */
    int asked;        /* internal steps of the last communication step, if it took more than one solve */
    int halved;       /* how many of these were halved; the next two are of the first of them */
    double first_h;   /* last_h[0] before it */
    int halved_step[PH_KEPT_HALVED];
    uint64_t halved_ends[PH_KEPT_HALVED]; /* bit l: a substep ends at l + 1 */
} ph_head;

/* An array of numbers, each of which is one or those of several runs. */
typedef struct ph_array {
    double *data;
    int n;
} ph_array;

#define PH_STATE_ARRAYS (10 + PH_NROW) /* see ph_state_arrays */

/* Work space of directional derivatives of a step; x is NULL without tangents. */
typedef struct ph_chain {
    double *x;        /* nx+1+na: old states of an internal step */
    double *dy;       /* nv+nz: a direction of Y */
    double *dr;       /* nrow: the change of the rows along it */
    double *last;     /* nw: unknowns of the last step, put back at the end */
    double *basis;    /* k*k: Lagrange polynomials of the step at the nodes of a part */
    double *du;       /* nu (k*nu): directions of the held inputs, as are the next two */
    double *dx;       /* nu (nx+1+na) */
    double *dy_node;  /* nu (k*nu) */
    const double *dp; /* np: the present direction of the parameters, not owned; NULL: they stay */
    double *local;    /* arguments and results of one kernel */
    double *work;     /* of one kernel, as are the next three */
    int *iw;
    const double **arg;
    double **res;
} ph_chain;

/* The tape, which is told of every accepted part of a step before the state moves; see reverse/reverse.h. */
typedef struct ph_tape ph_tape;
struct ph_tape {
    void (*take)(ph_tape *tape, const ph_instance *in, double h);
    double *rows; /* room x width */
    int room, width;
    int n;    /* rows taken */
    int full; /* 1: a part found no room */
};

struct ph_instance {
    const ph_model *model;
    size_t state_size;
    int offset[PH_NBLOCK + 1];

    /* State: one block without pointers, addressed from here. */
    ph_head *head;
    ph_real *table;      /* signal table */
    ph_real *rest;       /* nx: what compensated summation still owes x */
    ph_real *table_rest; /* nq + 3 ncomp: the same for the cumulative energies */
    ph_real *row[PH_NROW];
    ph_real *u;              /* nu*k */
    ph_real *p;              /* np */
    ph_real *x_old;          /* nx+1+na: states, time, algebraic variables at the start of the last step */
    ph_real *u_old;          /* nu*k: inputs of the last step */
    ph_real *first;          /* nw: unknowns it began from, if it took more than one solve */
    ph_real *y_node;         /* nq*k: pair outputs at the nodes of the last step; none if k = 1 */
    ph_real *reach;          /* ncomp if a Schur stepper may solve steps: most energy in play so far */
    ph_rest_change *changes; /* PH_KEPT_CHANGES if constraints may rest */

    /* Work space. */
    ph_system step, instant;
    void *schur;        /* work space of the Schur stepper, or NULL */
    int fast;           /* 1: the Schur stepper has solved the last part */
    int planned;        /* 1: those constraints rest that the Schur stepper leaves out */
    void *backup;       /* state_size */
    ph_real *stored;    /* ncomp */
    ph_real *moved;     /* ncomp */
    ph_real *lost;      /* ncomp */
    ph_real *numerical; /* ncomp */
    ph_real *given;     /* ncomp, as is the next one, if a Schur stepper may solve steps: supplied energy */
    ph_real *in_play;   /* energy in play, see judge.h */
    ph_real *energies;  /* nq: of the pairs, inputs times outputs */
    ph_real *means;     /* nq: of their outputs */
    ph_real *unspread;  /* nw if constraints may rest: unknowns before ph_rest_spread */
    double *basis;      /* k */
    ph_real *change;    /* nx */
    ph_chain chain;
    ph_tape *tape;   /* or NULL */
    long long begun; /* count[PH_ITERATIONS] at the start of the internal step */
    long long count[PH_NCOUNT];
    ph_report report;
};

static inline void ph_clear(ph_real *values, int n) {
    for (int i = 0; i < n; i++)
        values[i] = PH_REAL_SPREAD(0.0);
}

/* Bytes of the instance of in->model with all it points to; with `memory` (that many, its own) the pointers
 * are set too. */
size_t ph_lay_out(ph_instance *in, char *memory);
int ph_state_arrays(ph_instance *in, ph_array *out);
int ph_trusts(const ph_head *head);
void ph_measure_trust(ph_head *head, int most, int trusts, int iterations, int factored);
int ph_finite(const double *values, int n);
ph_truth ph_weigh(ph_instance *in, double h);
ph_truth ph_closes(const ph_instance *in);
void ph_accept(ph_instance *in, double h, double from, double weight);
void ph_begin_step(ph_instance *in, double h);
void ph_finish_step(ph_instance *in, double t);
void ph_clear_ledger(ph_instance *in);
void ph_write_row(ph_instance *in, const ph_record *r, int row);
int ph_is_sliver(const ph_instance *in, double t, double h);
void ph_resample(ph_instance *in, double from, double length, ph_real *u);
void ph_inputs_at(ph_instance *in, double theta, ph_real *u);
void ph_basis(ph_instance *in, double theta);
void ph_book_nodes(ph_instance *in, double from, double weight);
void ph_seed(ph_instance *in, const double *a);
void ph_solve_refined(ph_system *s);         /* dw = A^-1 rhs; changes rhs and base */
void ph_parts_begin(ph_instance *in, int n); /* a step of n internal ones, or of one that is halved */
void ph_part_ends(ph_instance *in, int i, int end);
int ph_parts_fit(const ph_head *head); /* whether the parts in a state of anybody's are those of a step */
int ph_part_end(const ph_instance *in, int i,
                int at);                              /* of the part of internal step i that begins at `at` */
void ph_take_instant(ph_instance *in, int algebraic); /* means = values at the present time */

#endif
