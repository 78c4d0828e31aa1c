/* Instances of a discretised model: create, set inputs, step, read, save.
 *
 * An instance lives in one block of memory given by the caller; nothing is allocated later and there
 * are no globals. Units are SI, power is positive into the component. Functions return a ph_status;
 * after a failed step the instance is exactly at its last accepted step. */
#ifndef PHFMU_H
#define PHFMU_H

#include <stddef.h>

#include "plan.h"
#include "step_limits.h"

#ifndef PH_API
#ifdef _WIN32
#define PH_API __declspec(dllexport)
#else
#define PH_API __attribute__((visibility("default")))
#endif
#endif

#define PH_STATUS_LIST(X)                                                                                    \
    X(PH_OK, "step accepted")                                                                                \
    X(PH_NO_CONVERGENCE, "Newton's method did not converge")                                                 \
    X(PH_SINGULAR, "the Newton matrix is singular: an equation is missing or redundant")                     \
    X(PH_NOT_FINITE, "a value is not finite")                                                                \
    X(PH_LU_CAPACITY, "the factors of the Newton matrix outgrew the reserved memory")                        \
    X(PH_ABI, "model tables and compiled runtime do not belong together")                                    \
    X(PH_ARGUMENT, "an argument is out of range")                                                            \
    X(PH_VALUE, "a given value is not finite; it was not taken over")                                        \
    X(PH_NO_SENSITIVITY, "the sensitivity needs a last step of which at most 16 internal steps were halved") \
    X(PH_EVENT, "a state event cannot happen")                                                               \
    X(PH_UNIT, "a unit of another tool refused a call")

#define PH_STATUS_NAME(name, text) name,
typedef enum ph_status { PH_STATUS_LIST(PH_STATUS_NAME) PH_NSTATUS } ph_status;
#undef PH_STATUS_NAME

/* Blocks of the signal table, in this order. Up to PH_RESIDUAL they belong to the last step; the
 * blocks from PH_A_END on hold at the present time and are solved for only when asked (ph_refresh). */
typedef enum ph_block {
    PH_X,           /* nx state */
    PH_TIME,        /* 1 */
    PH_A,           /* na algebraic variables, means of the step */
    PH_Y_STEP,      /* nq pair outputs, step-conjugate means */
    PH_ENERGY,      /* nq cumulative energy through each pair */
    PH_SUPPLIED,    /* ncomp cumulative energy supplied through ports */
    PH_DISSIPATED,  /* ncomp cumulative dissipated energy */
    PH_RESIDUAL,    /* ncomp cumulative stored + dissipated + numerical - supplied */
    PH_A_END,       /* na algebraic variables now */
    PH_Y_END,       /* nq pair outputs now */
    PH_OBSERVABLES, /* nobs */
    PH_H,           /* ncomp stored energy now */
    PH_NBLOCK
} ph_block;

/* Blocks of the ledger of the last communication step. */
typedef enum ph_row {
    PH_ROW_STORED,     /* ncomp change of stored energy */
    PH_ROW_DISSIPATED, /* ncomp */
    PH_ROW_SUPPLIED,   /* ncomp */
    PH_ROW_NUMERICAL,  /* ncomp lost by the scheme itself, zero unless it is Radau */
    PH_ROW_MOVED,      /* ncomp sum over the energies of |change| */
    PH_ROW_PAIRS,      /* nq energy through each pair */
    PH_NROW
} ph_row;

typedef enum ph_count {
    PH_STEPS,         /* communication steps accepted */
    PH_SOLVES,        /* nonlinear systems solved for steps */
    PH_ITERATIONS,    /* Newton iterations of steps and end values, polish not counted */
    PH_FACTORED,      /* factorisations of the Newton matrix */
    PH_PIVOTED,       /* those with a new pivot search */
    PH_RESTARTS,      /* solved from rest or from shorter steps */
    PH_LINE_SEARCHES, /* solved with line search */
    PH_SUBSTEPS,      /* halvings of a step */
    PH_FAILED,        /* communication steps refused */
    PH_SCHUR,         /* solved by the Schur stepper */
    PH_SWEEPS,        /* its sweeps */
    PH_INSTANTS,      /* evaluations of the end values */
    PH_EXCHANGED,     /* redundant constraints that rest in place of others */
    PH_WOKEN,         /* constraints at rest that were needed again */
    PH_NCOUNT
} ph_count;

/* Why the last solve failed; row and column are -1 where they do not apply. */
typedef struct ph_report {
    int status;
    int row;         /* row of the largest scaled residual, or the row without entries */
    int column;      /* unknown without a pivot */
    int iterations;  /* of the last attempt */
    int spent;       /* of all attempts at the internal step */
    int instant;     /* 1: in the system of the end values, 0: in a step */
    int solved;      /* internal steps of the communication step that were solved before it was refused */
    double residual; /* its scaled value */
    double floor;    /* what rounding alone leaves of it */
    double update;   /* last scaled update norm */
    double time;     /* start of the refused substep */
    double h;        /* its length */
} ph_report;

/* A redundant constraint that rests from the end of a step on, and one that does not any longer; -1: none. */
typedef struct ph_rest_change {
    double time;
    int rests, needed;
} ph_rest_change;

typedef struct ph_instance ph_instance;

/* Bytes of memory an instance needs; 0 if model and runtime do not belong together. */
PH_API size_t ph_size(const ph_model *model);
/* memory: ph_size bytes aligned for double, owned by the caller; model must outlive it. */
PH_API int ph_init(void *memory, const ph_model *model);
/* Back to the start values of the model (state, algebraic guess, inputs, parameters, ledger). */
PH_API int ph_reset(ph_instance *in);
/* Forget the last solution: the next solve does not start from it, so that what follows does not depend, not
 * even in the last bit, on what was asked before. To be followed by ph_initialise. */
PH_API void ph_forget(ph_instance *in);
/* Solves the instant system: algebraic variables, outputs, observables and H become valid, and the
 * step means take their values. */
PH_API int ph_initialise(ph_instance *in);

/* Values that are not finite are refused with PH_VALUE and change nothing.
 * u: nu, held over the step. */
PH_API int ph_set_input(ph_instance *in, const double *u);
/* u: k*nu, node-major: the values at the quadrature nodes of the next step. */
PH_API int ph_set_node_inputs(ph_instance *in, const double *u);
PH_API int ph_set_parameters(ph_instance *in, const double *p);  /* p: np */
PH_API int ph_set_x(ph_instance *in, double t, const double *x); /* x: nx */
PH_API int ph_set_algebraic(ph_instance *in, const double *a);   /* a: na, start values */
PH_API const double *ph_parameters(const ph_instance *in);       /* np */
PH_API const double *ph_input(const ph_instance *in);            /* k*nu */
/* k*nq, node-major: pair outputs that belong to the node inputs of the last communication step of length h,
 * h sum_i weights[i] u[i] y[i] = energy through the pair, exactly, for any number of internal steps. */
PH_API const double *ph_node_outputs(const ph_instance *in);

/* Takes over state, time, held inputs, parameters and cumulative energies of an instance of the same
 * declaration under another scheme, and goes on from there. */
PH_API int ph_continue(ph_instance *in, const ph_instance *from);

/* One step over [t, t+h]; ph_step_parts takes it as n equal internal steps. h < 0 goes back in time: the
 * schemes are symmetric, so a step and the same step back give the old state to rounding. h = 0 leaves the
 * state as it is, books nothing and gives the step means their values at t. A sliver (step_limits.h, the
 * internal step being the last one) is skipped. */
PH_API int ph_step(ph_instance *in, double t, double h);
PH_API int ph_step_parts(ph_instance *in, double t, double h, int n);
/* ph_step_parts, however short the step is. */
PH_API int ph_step_exactly(ph_instance *in, double t, double h, int n);
/* Move to the time t in a step too short to be one: state, multipliers and step means stay, nothing is
 * booked. The values at the present time follow the inputs. */
PH_API int ph_skip(ph_instance *in, double t);

/* Steps one after the other told as one: `kept` (ph_kept_size) has rows, means and energies of what came
 * before the last step, `part` of the length of both together. */
PH_API int ph_kept_size(const ph_model *model);
PH_API void ph_keep(const ph_instance *in, double *kept);
PH_API void ph_join(ph_instance *in, const double *kept, double part);

/* A column the caller gives: row i goes to data + i*stride; not wanted if data is NULL. */
typedef struct ph_column {
    double *data;
    ptrdiff_t stride;
} ph_column;

typedef struct ph_record {
    const double *input;    /* one row of inputs a step, or NULL: inputs stay */
    ptrdiff_t input_stride; /* in doubles */
    int at_nodes;           /* a row has values at the nodes, k*nu; else held ones, nu */
    int parts;              /* internal steps per step */
    long long first;        /* number of the first step */
    ph_column signals;      /* whole signal table, end values included */
    ph_column x;            /* nx */
    ph_column a;            /* na */
    ph_column y_step;       /* nq */
    ph_column pairs;        /* nq energies of the step */
    ph_column stored;       /* ncomp of the step */
    ph_column dissipated;   /* ncomp of the step */
    ph_column supplied;     /* ncomp of the step */
    ph_column numerical;    /* ncomp of the step */
    ph_column moved;        /* ncomp of the step */
    ph_column unknowns;     /* step.nw of its last solve */
    ph_column energy;       /* ncomp stored energy at the end of the step */
    ph_column counts;       /* 2: iterations and solves of the step */
} ph_record;

/* Steps k = first..first+n-1 from t0 + k h, so that a run gives the same bits however it is cut; *done: steps
 * accepted. record may be NULL. A step whose end values are recorded but cannot be solved for is taken back.
 */
PH_API int ph_run(ph_instance *in, double t0, double h, int n, const ph_record *record, int *done);

/* offset: PH_NBLOCK+1 places of the blocks in the signal table, the last one its length. */
PH_API void ph_layout(const ph_model *model, int *offset);
/* The table, owned by the instance, valid until it is freed. */
PH_API const double *ph_signals(const ph_instance *in);
/* Brings the end values up to date; costs nothing if they are. */
PH_API int ph_refresh(ph_instance *in);
/* Ledger of the last communication step: ncomp values, or nq for PH_ROW_PAIRS. */
PH_API const double *ph_ledger(const ph_instance *in, int row);
/* Solved unknowns of the last solve of a step: w of the plan, nw values. */
PH_API const double *ph_unknowns(const ph_instance *in);
/* The last PH_KEPT_CHANGES of them, number i at i % PH_KEPT_CHANGES; *n: how many since the start. */
PH_API const ph_rest_change *ph_rest_changes(const ph_instance *in, int *n);
/* S: nu*nu row-major, S[i,j] = d (step mean of external output i) / d (held input j), last step. Over several
 * internal steps or substeps it takes the tangents of the model. */
PH_API int ph_sensitivity(ph_instance *in, double *s);
/* Number of solves of the last step; 0: none, or so many that it has no sensitivity. */
PH_API int ph_solves(const ph_instance *in);
/* S of the outputs at the present time in place of the step means. */
PH_API int ph_sensitivity_end(ph_instance *in, double *s);

/* n directions, one after the other. */
typedef struct ph_directions {
    int n;
    const double *du; /* n (k*nu): of the inputs at the nodes of the last step, in */
    double *dx;       /* n (nx+1+na): of the states, the time and the algebraic variables carried along */
    double *dy;       /* outputs */
    const double *dp; /* n np: of the parameters, in; NULL: they stay. Only where the model has slopes */
    double *da;       /* n na: of the algebraic variables, out; NULL: not asked for */
    double *dobs;     /* n nobs: of the observables now, out; NULL: not asked for */
} ph_directions;

/* Directional derivatives of the last step, with tangents only. dx: of the state at its start, in, and at its
 * end, out; dy: n (k*nu), of the outputs at the nodes, conjugate to its node inputs; da: of the means. */
PH_API int ph_step_along(ph_instance *in, const ph_directions *d);
/* Directional derivatives of the outputs at the present time, the end of that step; dx: of the present state,
 * in; dy: n nu. */
PH_API int ph_end_along(ph_instance *in, const ph_directions *d);

/* Complete state, without pointers: restored into any instance of the model the same bits follow. */
PH_API size_t ph_state_size(const ph_instance *in);
PH_API void ph_save(const ph_instance *in, void *out);
PH_API int ph_load(ph_instance *in, const void *from);
/* For a state (ph_state_size bytes, aligned for double) that others wrote: NULL if ph_load may read it, else
 * what is wrong in it. Nothing of the instance changes. */
PH_API const char *ph_state_fault(const ph_instance *in, const void *from);

PH_API const long long *ph_counts(const ph_instance *in); /* PH_NCOUNT, since ph_init */
PH_API const ph_report *ph_last_report(const ph_instance *in);
PH_API const char *ph_status_text(int status);

/* sum += term; rest keeps what rounding owes. */
static inline void ph_add(ph_real *sum, ph_real *rest, ph_real term) {
    ph_real y = term - *rest, t = *sum + y;
    *rest = (t - *sum) - y;
    *sum = t;
}

#endif
