/* One co-simulation instance, whatever the version of the interface: modes, values, steps, saved state.
 *
 * The layers fmi2.c and fmi3.c translate their calls into these functions. Functions return FMU_OK,
 * FMU_DISCARD or FMU_ERROR, which both versions number alike; every error has been logged. An instance
 * is one block of memory; only a saved state asked for by the importer is allocated later. */
#ifndef FMU_H
#define FMU_H

#include <stddef.h>

#include "step_map.h"

/* Values of fmi2Status and fmi3Status. */
enum { FMU_OK = 0, FMU_DISCARD = 2, FMU_ERROR = 3 };

/* Modes of an instance; functions name the ones they are allowed in as a mask. */
enum { FMU_INSTANTIATED = 1, FMU_INITIALIZATION = 2, FMU_STEP = 4, FMU_TERMINATED = 8, FMU_ANY = 15 };

/* Places of values that are not in the signal table; the rows of the ledger in the order of ph_row. FMU_GAP:
 * what the ledger does not explain of the stored energy. An input is held: it stands for the values at all
 * nodes of a step, of which FMU_NODE_INPUT is one. */
enum {
    FMU_PARAMETER = PH_NBLOCK,
    FMU_TUNABLE, /* a parameter that may also be set between steps */
    FMU_INPUT,
    FMU_ROW_STORED,
    FMU_ROW_DISSIPATED,
    FMU_ROW_SUPPLIED,
    FMU_ROW_NUMERICAL,
    FMU_ROW_MOVED,
    FMU_GAP,
    FMU_JUMPED, /* change of stored energy by tunable parameters and state events since the start */
    FMU_NODE_INPUT,
    FMU_NODE_OUTPUT,
    FMU_ROW_PAIRS,
    FMU_IMPULSE, /* at the start of the coming step, then those at its end */
    FMU_JUMP,    /* of all impulses, row-major */
    FMU_MODE,    /* a parameter that state events set */
    FMU_JOINED,  /* what only the whole of coupled members tells */
    FMU_HAPPENED /* how many state events there were, when the last one was, what they lost */
};

typedef struct fmu fmu;

/* The value is `sign` times the sum of `count` entries of a block from `first` on; the value reference is the
 * place of the variable in its table. */
typedef struct fmu_variable {
    int block; /* ph_block or one of the places above */
    int first;
    int count;
    const char *name;
    int sign; /* -1: a flow that counts out of the unit; else 1 */
} fmu_variable;

/* A hidden constraint: at the start its residual must not exceed the limit. */
typedef struct fmu_check {
    int variable; /* value reference of the residual */
    double limit;
} fmu_check;

/* Limits of a parameter, checked when initialization ends and when it is set later; `above`: min itself is
 * not allowed. */
typedef struct fmu_range {
    int variable; /* value reference */
    double min, max;
    int above;
} fmu_range;

/* Functions of impulses.c, which only units have whose ports take some. */
struct ph_ports;
struct ph_impulses;
typedef struct fmu_impulses {
    int n; /* scalar ports with impulses */
    const struct ph_ports *ports;
    size_t (*size)(const ph_instance *in, const struct ph_ports *ports);
    struct ph_impulses *(*init)(void *memory, ph_instance *in, const struct ph_ports *ports);
    int (*set)(struct ph_impulses *m, const double *s);
    double *(*values)(struct ph_impulses *m);
    int (*step)(struct ph_impulses *m, double t, double h, int n);
    int (*kick)(struct ph_impulses *m, double t);
    void (*jump)(struct ph_impulses *m, double *s);
    void (*along)(struct ph_impulses *m, int end, int count, const double *ds, double *dx);
    void (*by)(struct ph_impulses *m, int end, const double *dp, double *dx);
    void (*jump_along)(struct ph_impulses *m, const double *dx, const double *dp, double *ds);
} fmu_impulses;

/* Functions of fmu_landing.c, which only units with state events have. */
struct ph_events;
typedef struct fmu_landing {
    const struct ph_events *events;
    const char *const *names; /* of the guards */
    int (*create)(fmu *f);
    void (*release)(fmu *f);
    int (*step)(fmu *f, double t, double h, int n, int *stopped);
    int (*refused)(const fmu *f, const char *function);
    const struct fmu_switches *switches; /* NULL without ideal switches */
} fmu_landing;

/* At `time` a parameter takes `value`. */
typedef struct fmu_event {
    double time;
    int variable; /* value reference */
    double value;
} fmu_event;

/* Equations of a model, for messages. */
typedef struct fmu_equations {
    const char *member; /* of a network, else "" */
    int nstep, ninstant;
    const char *const *step;    /* nstep rows of a step */
    const char *const *instant; /* ninstant rows of the end values */
} fmu_equations;

/* What is generated for one unit, constant. */
typedef struct fmu_interface {
    const char *token; /* FMU_TOKEN characters */
    const ph_step_map *(*map)(void);
    const void *of; /* what the map is about: a ph_model, or a ph_network */
    double step;    /* longest internal step, s */
    int nvariable, ncheck, nrange;
    const fmu_variable *variables;  /* nvariable */
    const int *sizes;               /* nvariable, of FMI 3.0: scalars from here on; NULL without arrays */
    const fmu_check *checks;        /* ncheck */
    const fmu_range *ranges;        /* nrange */
    const fmu_equations *equations; /* of each part of the map */
    int jumps;                      /* whether stored energy depends on a tunable parameter */
    int (*node_memory)(fmu *f);     /* fmu_nodes.c; NULL without inputs at nodes */
    int (*node_map)(fmu *f);
    size_t (*along_room)(const struct fmu_interface *about,
                         const ph_sizes *sizes); /* fmu_along.c; NULL without derivatives by states */
    int (*along)(fmu *f, const char *function, int adjoint, const unsigned *unknown, size_t nu,
                 const unsigned *known, size_t nk, const double *seed, double *result);
    int (*asks_along)(const fmu *f, const unsigned *unknown, size_t nu, const unsigned *known, size_t nk);
    const fmu_impulses *impulses; /* NULL if ports take none */
    int nevent;
    const fmu_event *events;    /* nevent, in order of time */
    const fmu_landing *landing; /* NULL without state events */
} fmu_interface;

#define FMU_TOKEN 38
#define FMU_SLACK 1e-9 /* a communication step this much longer than n internal ones is still n of them */

extern const fmu_interface fmu_the_interface;

/* Categories of messages, a mask; names in fmu_log.c. */
enum { FMU_LOG_ERRORS = 1, FMU_LOG_HALVED = 2, FMU_LOG_ALL = 3 };

/* Passes a message on to the importer through `callback`. */
typedef void (*fmu_sink)(const fmu *f, int status, const char *category, const char *text);

/* What a saved state holds besides the state of the model. */
typedef struct fmu_phase {
    int mode;
    int stop_defined;
    double start, stop;
    double steps;       /* taken since the start */
    double happened[3]; /* state events since then: how many, the time of the last, energy they lost */
    int passed;         /* events that have happened */
    int crossed;        /* parameters changed in the last step or after it */
} fmu_phase;

/* The stored energy and what was booked as its change, ncomp each; one stretch of memory. */
typedef struct fmu_books {
    double *start;  /* H when initialization ended */
    double *booked; /* sum of its changes by the ledgers of all steps */
    double *rest;   /* what compensated summation still owes `booked`, to be subtracted */
    double *jumped; /* sum of its changes by tunable parameters between steps, and by state events */
    double *before; /* H while they change, not saved */
} fmu_books;

/* A step that was discarded: its start, its length, and a hash of the state and inputs that it began with. */
typedef struct fmu_discarded {
    double t, h;
    unsigned long long from;
} fmu_discarded;

#define FMU_NBOOKS 4

/* Of units with inputs at nodes, in a second block of memory; zero in others. Columns of derivatives are
 * those of nk*nu inputs at nodes, then of 2n impulses. */
typedef struct fmu_nodes {
    void *memory; /* owned */
    struct ph_impulses *impulses;
    double *s;    /* 2n: impulses being set */
    double *jump; /* n*n */
    int columns;
    double *du, *ds, *dx;     /* a row for each column: k*nu, n, nx+1+na */
    double *by_node, *by_end; /* derivatives, a row for each column: k*nu outputs at nodes, nu at the end */
    int known;                /* whether they belong to the last step */
} fmu_nodes;

struct fmu {
    const fmu_interface *about;
    const ph_step_map *map;
    void *of; /* what takes steps: a model's instance, or a network */
    ph_sizes sizes;
    fmu_phase phase;
    int logging; /* categories that are passed on */
    fmu_sink sink;
    void (*callback)(void); /* the importer's logger, cast back by the sink */
    void *environment;
    char *name;                /* owned */
    int offset[PH_NBLOCK + 1]; /* of the signal table */
    double *x, *u, *p, *old;   /* nx, nu*k, np, np: values being set, parameters before */
    int early;                 /* a step may end before its end */
    double solved;             /* length of what could be solved of a discarded step, the last call; else 0 */
    fmu_discarded discarded;   /* the last step that was */
    fmu_books books;           /* saved with the state, as one stretch of FMU_NBOOKS*ncomp */
    double *step_derivative, *end_derivative; /* nu*nu sensitivities, row-major */
    int step_known, end_known;                /* whether they belong to the present time */
    double *direction;                        /* of fmu_along.c, along_room */
    unsigned *scalars; /* 2*nvariable, room for the scalars of arrays; NULL without arrays */
    fmu_nodes nodes;
    double *kept;                /* what of the parts of a step is summed; NULL without events */
    void *before;                /* a saved state; NULL without events */
    void *landed;                /* memory of fmu_landing.c, owned; NULL without state events */
    const struct fmu_mode *mode; /* the present one, see fmu_modes.h; NULL without ideal switches */
    void *modes;                 /* memory of fmu_modes.c, owned; NULL without ideal switches */
};

#if defined(__GNUC__)
#define FMU_FORMAT(text, values) __attribute__((format(printf, text, values)))
#else
#define FMU_FORMAT(text, values)
#endif

/* fmu_log.c; both return their status */
int fmu_say(const fmu *f, int status, int category, const char *format, ...) FMU_FORMAT(4, 5);
int fmu_refuse(const fmu *f, const char *format, ...) FMU_FORMAT(2, 3);
int fmu_log(fmu *f, const char *function, int on, size_t n, const char *const *categories); /* n = 0: all */
int fmu_allow(const fmu *f, const char *function, int modes);
int fmu_given(const fmu *f, const char *function, int given); /* refuses a null pointer */
int fmu_solver(const fmu *f, const char *what, int status);
/* `rows`: those that `why` is about; answers `answer`, also in logs. */
int fmu_step_refused(const fmu *f, const char *what, int answer, const ph_report *why,
                     const fmu_equations *rows);
/* The equations of what refused the last step. */
const fmu_equations *fmu_refusing(const fmu *f);

/* fmu.c. NULL if the token is another model's, there is no memory, or a unit inside does not start;
 * resources: their folder, a path or an URI. */
fmu *fmu_create(const char *name, const char *token, const char *resources, int logging, fmu_sink sink,
                void (*callback)(void), void *environment);
void fmu_free(fmu *f);
int fmu_setup(fmu *f, const char *function, double start, int stop_defined, double stop);
int fmu_enter(fmu *f, const char *function);
int fmu_leave(fmu *f, const char *function);
int fmu_terminate(fmu *f, const char *function);
int fmu_reset(fmu *f, const char *function);
/* FMU_DISCARD: the step cannot be solved, the instance is where it was. *early (may be NULL): the step ended
 * at a communication point before its end, which only an instance with `early` does. */
int fmu_do_step(fmu *f, const char *function, double t, double h, int *early);
double fmu_time(const fmu *f);

/* fmu_values.c. ref: n value references, values: n. A refused call changes nothing. */
int fmu_get(fmu *f, const char *function, const unsigned *ref, size_t n, double *values);
int fmu_set(fmu *f, const char *function, const unsigned *ref, size_t n, const double *values);
void fmu_parameters(fmu *f);               /* into f->p, with the modes that were asked for */
int fmu_set_parameters(fmu *f, double *p); /* p (np); books what they make of H; answers a ph_status */
int fmu_check_ranges(const fmu *f, const char *function);
/* Impulses of the coming steps and of the last one: 4 fmu_impulses.n values, or none. */
double *fmu_impulse_values(const fmu *f, int *n);
int fmu_kicked(const fmu *f);                /* whether the coming steps have impulses */
int fmu_held(const fmu *f, const double *u); /* u (nu*k): the same at all nodes */

/* fmu_nodes.c. The memory of `nodes`: 0 if there is none. Derivatives of the last step with respect to its
 * inputs at nodes and its impulses, as `by_node` and `by_end`: a ph_status. */
int fmu_node_memory(fmu *f);
int fmu_node_map(fmu *f);

/* fmu_events.c. Without events in the unit nothing is allocated. */
int fmu_events_create(fmu *f);
void fmu_events_free(fmu *f);
int fmu_events_until(fmu *f, double t);          /* makes those happen; answers a ph_status */
int fmu_events_within(const fmu *f, double end); /* whether one comes before `end` */
/* A step from t by h in parts; times that differ by less than slack are one. *early as of fmu_do_step. */
int fmu_events_step(fmu *f, const char *function, double t, double h, double slack, int *early);

/* fmu_landing.c, as fmu_landing: `step`: [t, t+h] in n internal steps with the state events in it, told as
 * one; *stopped (may be NULL): it ended at one of them before its end. Answers a ph_status; after a refused
 * one f is to be restored. `refused`: says why an event could not happen, answers FMU_DISCARD. */
int fmu_landing_create(fmu *f);
void fmu_landing_release(fmu *f);
int fmu_landing_step(fmu *f, double t, double h, int n, int *stopped);
int fmu_landing_refused(const fmu *f, const char *function);
struct ph_landed;
struct ph_landed *fmu_landing_out(const fmu *f); /* what an event is written to */
void fmu_landing_book(fmu *f,
                      const struct ph_landed *out); /* the event in it, what it made of stored energy */

/* fmu_happened.c: n state events, the last one at t, what they made of stored energy and lost (ncomp); why
 * one was refused, whose guards have these n names. */
struct ph_event_refusal;
void fmu_happened(fmu *f, int n, double t, const double *energy, const double *lost);
int fmu_event_refused(const fmu *f, const char *function, const struct ph_event_refusal *r, int n,
                      const char *const *guards);

/* fmu_derivative.c. adjoint 0: result (nu) = S seed (nk); 1: result (nk) = S^T seed (nu), where S holds the
 * derivatives of the port outputs `unknown` (nu) with respect to the port inputs `known` (nk): all of these
 * held over a step, or all at nodes and impulses. */
int fmu_derivative(fmu *f, const char *function, int adjoint, const unsigned *unknown, size_t nu,
                   const unsigned *known, size_t nk, const double *seed, double *result);

/* fmu_along.c. Whether a call is about more than outputs by inputs; what it then answers, as fmu_derivative,
 * the knowns being states (at the start of the last step; for values at the present time those there),
 * parameters and inputs, the unknowns states at the end of the step and what is told of it or now; how many
 * doubles it needs. */
int fmu_asks_along(const fmu *f, const unsigned *unknown, size_t nu, const unsigned *known, size_t nk);
int fmu_along(fmu *f, const char *function, int adjoint, const unsigned *unknown, size_t nu,
              const unsigned *known, size_t nk, const double *seed, double *result);
size_t fmu_along_room(const fmu_interface *about, const ph_sizes *p);

/* fmu_state.c. A saved state is one block without pointers; *state is reused if not NULL. */
int fmu_save(fmu *f, const char *function, void **state);
int fmu_restore(fmu *f, const char *function, const void *state);
int fmu_forget(fmu *f, void **state);
size_t fmu_state_size(const fmu *f);
#define FMU_HASHED 14695981039346656037ULL                                         /* of nothing */
unsigned long long fmu_hash(unsigned long long hash, const void *bytes, size_t n); /* FNV-1a */
int fmu_written_size(fmu *f, const char *function, void *state, size_t *size);
int fmu_write(fmu *f, const char *function, void *state, void *bytes, size_t size);
int fmu_read(fmu *f, const char *function, const void *bytes, size_t size, void **state);

#endif
