/* A unit of another tool inside a unit of coupled members: what is constant of it, its instance, and the
 * calls of its version of the standard that begin and end it. Its steps are calls of
 * couplings/runtime/unit_fmi*.c.
 *
 * Its blocks: outputs of its ports, observables, which are all other values that it tells, and the energy
 * that was supplied, which counts as stored: what it dissipates it keeps to itself (unit_books.py). */
#ifndef PH_EMBEDDED_H
#define PH_EMBEDDED_H

#include <stdint.h>

#include "network.h"
#include "unit.h"

/* Platforms that units are compiled for. */
enum {
    PH_X86_64_LINUX,
    PH_AARCH64_LINUX,
    PH_X86_64_WINDOWS,
    PH_X86_64_DARWIN,
    PH_AARCH64_DARWIN,
    PH_NPLATFORM
};

struct ph_embedded_unit;

/* Types of values besides Float64. */
typedef enum ph_type {
    PH_INT8,
    PH_UINT8,
    PH_INT16,
    PH_UINT16,
    PH_INT32,
    PH_UINT32,
    PH_INT64,
    PH_UINT64,
    PH_FLOAT32,
    PH_BOOLEAN
} ph_type;

/* A variable of one of these: the function that sets or reads it, without its prefix, and of a start the
 * value as that takes it. */
typedef struct ph_typed {
    const char *function;
    ph_type type;
    unsigned reference;
    const void *value;
} ph_typed;

typedef void (*ph_reader)(void);

/* The calls of a version; they answer PH_OK, or PH_UNIT with what was answered in the unit. */
typedef struct ph_standard {
    const ph_version *(*version)(void);
    int (*bind)(struct ph_embedded_unit *e); /* functions of the library */
    int (*begin)(struct ph_embedded_unit *e, const char *name, const char *resources);
    int (*enter)(struct ph_embedded_unit *e, double start); /* Initialization Mode */
    int (*set)(struct ph_embedded_unit *e, const ph_typed *start);
    int (*find)(struct ph_embedded_unit *e, const ph_typed *told, ph_reader *to); /* what reads it */
    int (*get)(struct ph_embedded_unit *e, const ph_typed *told, ph_reader by, void *value);
    int (*leave)(struct ph_embedded_unit *e);
    int (*reset)(struct ph_embedded_unit *e);
    void (*end)(struct ph_embedded_unit *e);
    void (*forget)(struct ph_embedded_unit *e, void **state);
    int (*size)(struct ph_embedded_unit *e, void *state, size_t *size); /* of its bytes */
    int (*write)(struct ph_embedded_unit *e, void *state, char *bytes, size_t size);
    int (*read)(struct ph_embedded_unit *e, const char *bytes, size_t size, void **state);
} ph_standard;

/* A group without memory for values; see ph_scalars. */
typedef struct ph_embedded_about {
    const char *member; /* its name in the network, and that of its folder among the resources */
    const char *library[PH_NPLATFORM]; /* there; NULL: none for this platform */
    const char *identifier, *token;
    const ph_standard *(*standard)(void);
    int saves, serialises;
    int no_set_prior;   /* what trials are told as noSetFMUStatePriorToCurrentPoint */
    int in_parts;       /* whether a step is taken in two parts, of a third and two thirds */
    int tolerance_told; /* whether the tolerance is defined */
    double tolerance;   /* relative, of the experiment */
    int nu, np, ntyped, nother, nlooked, nwatched, ntaken;
    ph_scalars input;           /* of nu */
    ph_scalars looked;          /* what steps are booked with: nu outputs, then displacements */
    ph_scalars told;            /* observables */
    ph_scalars sent;            /* held signals that it sends */
    const ph_scalars *settable; /* np: each alone */
    const double *start;        /* np */
    const int *given;           /* np: whether its start is set although nobody changes it */
    const int *late;            /* np: whether it may be set after the start */
    const ph_typed *typed;      /* ntyped: starts that were given */
    const ph_typed *other;      /* nother: observables behind those told */
    const double *begin;        /* nu: inputs before anyone sets them, inward */
    const int *rate;            /* nu: place of the displacement whose rate the output is, or -1 */
    const int *watched;         /* nwatched: observables that have to be finite */
    const int *taken;           /* ntaken: places among the settable of held signals that it takes */
} ph_embedded_about;

typedef struct ph_embedded_unit {
    const ph_embedded_about *about;
    const ph_standard *standard;
    ph_unit unit;
    union {
        ph_fmi2 two;
        ph_fmi3 three;
    } functions;
    void *life;    /* functions of a version that begin and end it, owned, as all below */
    void *library; /* NULL: it was not loaded */
    char *folder;
    ph_surroundings around;
    char words[512]; /* its last message */
    ph_report report;
    ph_reader *readers; /* nother, owned */
    int begun;          /* it is initialised under the present parameters */
    int started;        /* it was initialised */
    int moved;          /* it has taken a step since `keep` */
    int lost;           /* a step was refused, and it cannot go back */
    void *state;        /* where it was, kept by it */
    void *memory;       /* what all pointers below are in */
    double *values;
    int nvalue; /* of values, which are saved: all below up to supplied */
    double *h;  /* of the last step */
    double *table;
    double *row[PH_NROW];
    double *p;
    double *given; /* nu: inputs, as it has them */
    double *after; /* nlooked: at the end of the last step, inward */
    double *supplied;
    double *kept;  /* nvalue; work, as all below */
    double *now;   /* nlooked */
    double *third; /* nlooked: at a third of the step */
    double *again; /* nu */
    ph_scalars input, looked, told, sent;
    int offset[PH_NBLOCK + 1];
} ph_embedded_unit;

const ph_step_map *ph_map_embedded(void);
const ph_kind *ph_kind_embedded(void);
/* The step that was accepted once more, from where it began, as one that will not be taken back. */
int ph_embedded_finish(void *of);

/* Of the map. Outputs and displacements now, inward;
 * outputs of ports now, in the table; inputs as `given`, or u, inward; held signals that it sends, and takes;
 * all that it tells. */
int ph_embedded_look(ph_embedded_unit *e, double *to);
int ph_embedded_look_now(ph_embedded_unit *e);
int ph_embedded_give(ph_embedded_unit *e);
int ph_embedded_set_input(void *of, const double *u);
int ph_embedded_tell(ph_embedded_unit *e, double *to);
int ph_embedded_take(ph_embedded_unit *e, const double *values);
int ph_embedded_refresh(void *of);

/* embedded_state.c: as of ph_step_map. */
size_t ph_embedded_state_size(const void *of);
int ph_embedded_returns(const void *about);
int ph_embedded_save(void *of, void *out);
int ph_embedded_load(void *of, const void *from);
const char *ph_embedded_state_fault(const void *of, const void *from);
void ph_embedded_forget(void *of, void *state);
int ph_embedded_held_size(void *of, void *state, size_t *n);
int ph_embedded_write_held(void *of, void *state, char *bytes);
int ph_embedded_read_held(void *of, void *state, const char *bytes, size_t n);

const ph_standard *ph_standard_fmi2(void);
const ph_standard *ph_standard_fmi3(void);

/* embedded_library.c. A refusal, told: PH_UNIT. */
int ph_embedded_refuse(ph_embedded_unit *e, const char *format, ...);
/* Of what a call answered: PH_OK, or its refusal, told. */
int ph_embedded_asked(ph_embedded_unit *e, int status);
/* The library of its folder; a function of it, 0 if there is none; the end of it. */
int ph_embedded_library(ph_embedded_unit *e);
int ph_embedded_function(ph_embedded_unit *e, const char *name, void *to, size_t size);
void ph_embedded_unload(ph_embedded_unit *e);
/* Its last message. */
void ph_embedded_hear(ph_embedded_unit *e, const char *text);
/* A path from a path or an URI, without a separator at its end; an URI of a path. Owned by the caller. */
char *ph_path_of(const char *place);
char *ph_uri_of(const char *path);

#endif
