/* The plan: one discretised system as index tables, sums of products and kernels.
 *
 * Mirror of the Python dataclasses; all tables are constant and shared by every instance. The Python
 * side reads the field lists from this header: one field a line, a plain size or a pointer to const.
 * A name a_b stands for the attribute a_b of the Python object, or for a.b. */
#ifndef PH_PLAN_H
#define PH_PLAN_H

#include <stddef.h>
#include <stdint.h>

#include "names.h"
#include "real.h"
#include "schur.h"

#define PH_VERSION 8
#define PH_STAMP                                                                                             \
    (((uint64_t)PH_VERSION << 48) | ((uint64_t)sizeof(ph_model) << 32) | ((uint64_t)sizeof(ph_plan) << 16) | \
     (uint64_t)sizeof(ph_group))

/* All instances of one kernel. Index tables are instance-major. */
typedef struct ph_group {
    int n;                    /* instances */
    int stage;                /* 0: outputs go to Z, 1: outputs go to rows */
    int late;                 /* 1: touches no residual row, skipped during the iteration */
    int reports;              /* 1: touches a row after the residual: a pair output or an observable */
    int slot;                 /* first Jacobian entry in V */
    int kernel;               /* index into the kernels of the code */
    int nx, ny, np, no, nj;   /* local sizes, checked against the kernel table */
    const int *xi;            /* n*nx */
    const int *yi;            /* n*ny */
    const int *pi;            /* n*np */
    const int *oi;            /* n*no */
    const signed char *power; /* no: power of h on each output */
    const int *owner;         /* n: component of each instance */
} ph_group;

/* Spaces: x = [old state nx | time | old algebraic variables na], v = [w nw | u nu*k | h], Y = [v | Z nz],
 * rows R = [residual nw | pair outputs nq*k | observables nobs]. */
typedef struct ph_plan {
    int nx, nw, nu, k, nz, np, nq, nobs, na, ncomp, nv, nrow;
    int ncondensed;         /* last rows of R that are copied to the end of Z after the solve */
    int nslot;              /* length of V, V[0] = 1 */
    int ngroup;             /* stage 0 groups come first */
    int nconst;             /* triplets R[row] += val h^pow Y[src] */
    int nconst_early;       /* those of residual rows, which come first */
    int nnz;                /* nonzeros of A */
    int nfixed, nvarying;   /* constant and varying parts of A */
    int nderivative;        /* entries of the other derivative blocks */
    int nreg;               /* regularised diagonal entries */
    int nhold;              /* holonomic constraints whose rows may rest, the same in both plans */
    int vanishing;          /* 1: rounding of forces moves a mass they act on, Newton begins with delta */
    int nupdate, nmean;     /* runs of the update, entries of the algebraic report */
    int nwork;              /* rows with the work of impulses */
    int carries;            /* 1: algebraic variables of the step's end enter the next; 0: means */
    int lucap;              /* room for the entries of L + U */
    int keep_most;          /* iterations that cost as much as a factor; 0: factors are not kept over steps */
    const ph_group *groups; /* ngroup */
    const int *const_row;   /* nconst */
    const int *const_src;   /* nconst */
    const double *const_val;          /* nconst */
    const signed char *const_pow;     /* nconst */
    const int *colptr;                /* nw+1: columns of A */
    const int *matrix_row;            /* nnz: rows of A, ascending inside a column */
    const int *fixed_entry;           /* nfixed: entry of A that gets value h^power */
    const double *fixed_value;        /* nfixed */
    const signed char *fixed_power;   /* nfixed */
    const int *varying_entry;         /* nvarying: entries of A that get sums of products too */
    const int *varying_ptr;           /* nvarying+1: their products */
    const int *varying_s;             /* first factor, index into V */
    const int *varying_t;             /* second factor, index into V */
    const double *varying_value;      /* coefficient */
    const signed char *varying_power; /* power of h */
    const int *order;                 /* nw: pivot columns */
    const int *pivot_row;             /* nw: preferred row of each pivot column, or -1 */
    const int *regularised;           /* nreg: entries of A that get delta in the factor */
    const int *hold_ptr;              /* nhold+1 */
    const int *hold_row;              /* rows of a constraint: its k nodes, then the velocity level */
    const int *hold_own;              /* their diagonal entries of A */
    const int *hold_rests;            /* nhold: 1 = redundant at the start, w[row] = 0 in place of its rows */
    const double *hold_size;          /* nhold: natural size of the velocity constraint */
    const int *silent_ptr;            /* nhold+1 */
    const int *silent;                /* all entries of A in the rows of a constraint */
    const int *derivative_row;        /* nderivative: residual row, or nw + output */
    const int *derivative_col;        /* nderivative: unknown, or nw + held input */
    const int *derivative_ptr;        /* nderivative+1 */
    const int *derivative_s;
    const int *derivative_t;
    const double *derivative_value;
    const signed char *derivative_power;
    const int *update_x;           /* nupdate: first state of a run */
    const int *update_n;           /* nupdate: its length; x[update_x + i] += sum c w[update_w + i] */
    const int *update_ptr;         /* nupdate+1: terms of each run */
    const int *update_w;           /* update_ptr[nupdate] */
    const double *update_c;        /* update_ptr[nupdate] */
    const int *mean_a;             /* nmean: a[mean_a] = sum mean_c h^mean_pow Y[mean_w] */
    const int *mean_w;             /* nmean */
    const double *mean_c;          /* nmean */
    const signed char *mean_pow;   /* nmean: 0 or -1 */
    const int *work_pair;          /* nwork: pairs[work_pair] += R[work_row] */
    const int *work_row;           /* nwork */
    const int *guess_ptr;          /* nw+1: start values from the last step */
    const int *guess_idx;          /* guess_ptr[nw] */
    const double *guess_val;       /* guess_ptr[nw] */
    const signed char *guess_pow;  /* guess_ptr[nw]: power of h / last h */
    const signed char *increments; /* nw: 1 = increment, zero in the second start */
    const double *weights;         /* k: quadrature weights */
    const double *nodes;           /* k: quadrature nodes on [0, 1] */
    const int *pair_src;           /* k*nq: Y index of the input of each pair at each node */
    const int *pair_owner;         /* nq: component of each pair */
    const double *nominal;         /* nw: size of each unknown */
    const ph_schur *schur;         /* NULL: the sparse Newton only */
} ph_plan;

/* A function as CasADi writes it, called with itself before its arguments. arg, res, iw, w: lengths of its
 * arguments, results and work; program: what it runs, if it is interpreted. */
typedef struct ph_function ph_function;
struct ph_function {
    int (*call)(const ph_function *self, const double **arg, double **res, int *iw, double *w, int mem);
    int arg, res, iw, w;
    const void *program;
};

typedef struct ph_code ph_code;

typedef struct ph_model {
    uint64_t stamp;              /* PH_STAMP of the writer */
    double t0;                   /* start time */
    const double *x0;            /* nx */
    const double *a0;            /* na */
    const double *u0;            /* nu */
    const double *p0;            /* np */
    const ph_plan *step;         /* one step of the scheme */
    const ph_plan *instant;      /* algebraic variables, outputs, observables and H at one instant */
    const ph_code *code;         /* kernels and solver */
    const ph_function *tangents; /* of the kernels, or NULL: no sensitivity over several internal steps */
    const ph_function *slopes;   /* of the kernels, by their parameters, or NULL */
} ph_model;

/* Arguments of the kernels: x old state, y = Y, p parameters, hp = {1, h, h^2}; work: where those that are
 * interpreted work. */
typedef struct ph_point {
    const ph_real *x, *y, *p;
    const double *hp;
    ph_real *work;
} ph_point;

/* One entry of the kernel table: loops over a group, compiled (group.inc) or interpreted (interpret.h).
 * value: target += h^power out; full: the same and the Jacobian slots into V;
 * ledger: stored[owner] += , moved[owner] += |stored|, lost[owner] += , numerical[owner] += (NULL if the
 * kernel has none). */
typedef struct ph_kernel ph_kernel;
struct ph_kernel {
    void (*value)(const ph_kernel *self, const ph_group *, const ph_point *, ph_real *target);
    void (*full)(const ph_kernel *self, const ph_group *, const ph_point *, ph_real *target, ph_real *slots);
    void (*ledger)(const ph_kernel *self, const ph_group *, const ph_point *, ph_real *stored, ph_real *moved,
                   ph_real *lost, ph_real *numerical);
    int nx, ny, np, no, nj;
    int nwork;           /* length of the work space it needs */
    const void *program; /* what it runs, if it is interpreted */
};

/* Code made of the equations of a model, beside its tables.
 * Rows of interpreted kernels may change to compiled ones at any time, as these give the same bits: functions
 * by single stores, the rest stays. */
typedef struct ph_code {
    uint64_t token; /* of the kernels, however they run: plans and saved states belong to them */
    int nkernel;
    const ph_kernel *kernels;
    const ph_schur_code *solver; /* NULL: Newton's method only */
} ph_code;

/* Length of the work space that all kernels need. */
static inline int ph_code_work(const ph_code *code) {
    int most = 0;
    for (int i = 0; i < code->nkernel; i++)
        most = code->kernels[i].nwork > most ? code->kernels[i].nwork : most;
    return most;
}

static inline void ph_value_of(const ph_code *code, const ph_group *g, const ph_point *at, ph_real *target) {
    const ph_kernel *kernel = &code->kernels[g->kernel];
    kernel->value(kernel, g, at, target);
}

extern const ph_code ph_the_code;
extern const ph_function ph_tangents[];
extern const ph_function ph_slopes[];

#endif
