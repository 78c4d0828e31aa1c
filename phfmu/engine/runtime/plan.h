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
#include "schur.h"

#define PH_VERSION 5
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
    int kernel;               /* index into ph_kernels */
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
    int nslot;               /* length of V, V[0] = 1 */
    int ngroup;              /* stage 0 groups come first */
    int nconst;              /* triplets R[row] += val h^pow Y[src] */
    int nconst_early;        /* those of residual rows, which come first */
    int nnz;                 /* nonzeros of A */
    int nfixed, nvarying;    /* constant and varying parts of A */
    int nderivative;         /* entries of the other derivative blocks */
    int nreg;                /* regularised diagonal entries */
    int nhold;               /* holonomic constraints whose rows may rest, the same in both plans */
    int vanishing;           /* 1: rounding of forces moves a mass they act on, Newton begins with delta */
    int nupdate, nmean;      /* runs of the update, entries of the algebraic report */
    int nwork;               /* rows with the work of impulses */
    int carries;             /* 1: algebraic variables of the step's end enter the next; 0: means */
    int lucap;               /* room for the entries of L + U */
    const ph_group *groups;  /* ngroup */
    const int *const_row;    /* nconst */
    const int *const_src;    /* nconst */
    const double *const_val; /* nconst */
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
    const int *mean_a;             /* nmean: a[mean_a] = sum mean_c h^mean_pow w[mean_w] */
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

/* The tangent of a kernel: (x, y, p, dx, dy) -> d out, as CasADi writes functions; NULL where no residual and
 * no pair output needs it. arg, res, iw, w: lengths of its arguments, results and work. */
typedef struct ph_tangent {
    int (*function)(const double **arg, double **res, int *iw, double *w, int mem);
    int arg, res, iw, w;
} ph_tangent;

typedef struct ph_model {
    uint64_t stamp;             /* PH_STAMP of the writer */
    uint64_t token;             /* ph_kernel_token of the kernels the plans index into */
    double t0;                  /* start time */
    const double *x0;           /* nx */
    const double *a0;           /* na */
    const double *u0;           /* nu */
    const double *p0;           /* np */
    const ph_plan *step;        /* one step of the scheme */
    const ph_plan *instant;     /* algebraic variables, outputs, observables and H at one instant */
    const ph_tangent *tangents; /* of the kernels, or NULL: no sensitivity over several internal steps */
} ph_model;

/* Where kernels read: x old state, y = Y, p parameters, hp = {1, h, h^2}. */
typedef struct ph_point {
    const double *x, *y, *p, *hp;
} ph_point;

/* One entry of the kernel table: loops over a group with kernel and gather inlined (group.inc).
 * value: target += h^power out; full: the same and the Jacobian slots into V;
 * ledger: stored[owner] += , moved[owner] += |stored|, lost[owner] += , numerical[owner] += (NULL if the
 * kernel has none). */
typedef struct ph_kernel {
    void (*value)(const ph_group *, const ph_point *, double *target);
    void (*full)(const ph_group *, const ph_point *, double *target, double *slots);
    void (*ledger)(const ph_group *, const ph_point *, double *stored, double *moved, double *lost,
                   double *numerical);
    int nx, ny, np, no, nj;
} ph_kernel;

extern const ph_kernel ph_kernels[];
extern const ph_tangent ph_tangents[];
extern const int ph_nkernel;
extern const uint64_t ph_kernel_token;

#endif
