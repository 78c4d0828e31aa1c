/* Coupled members as one step map: what is constant of them, and the map. */
#ifndef PH_NETWORK_H
#define PH_NETWORK_H

#include "impulses.h"
#include "master.h"
#include "native.h"
#include "step_map.h"

/* Memory that a structure points to: `at` bytes from its begin, a pointer to what is `first` in the memory of
 * all. */
typedef struct ph_room {
    size_t at;
    size_t first;
} ph_room;

/* A member that is no model, but a unit of another tool: what is constant of it, its step map, and what its
 * share is asked, whose `of` is what takes its steps. */
typedef struct ph_embedded {
    const void *about;
    const ph_step_map *(*map)(void);
    const ph_kind *(*kind)(void);
    int (*finish)(void *of); /* the step that was accepted once more, for good; NULL: it was */
    const int *taken;        /* parameters that held signals come into */
} ph_embedded;

/* State events: how many, the time of the last, what they made of stored energy, and what they lost. */
typedef struct ph_happened {
    int count;
    double last;
    double *energy; /* by component, as what is lost */
    double *lost;
} ph_happened;

/* State events of a member that happen inside its steps (as_unit/runtime/member_landing.c): what is constant
 * of them, and what takes these steps in the place of the functions of native.c. */
struct ph_events;
struct ph_event_refusal;
typedef struct ph_inside {
    const struct ph_events *events;
    const char *const *names; /* of the guards */
    void *(*make)(const struct ph_inside *about,
                  const ph_native *native); /* NULL: there is no memory; freed */
    const ph_kind *(*kind)(const void *of);
    const ph_happened *(*happened)(const void *of); /* in the last step, accepted or not */
    const struct ph_event_refusal *(*refusal)(const void *of);
} ph_inside;

/* A member: its part of the exchange without memory, and what belongs to its model. */
typedef struct ph_network_member {
    const ph_model *model;
    const ph_embedded *unit; /* in the place of a model; NULL */
    const ph_ports *ports;   /* NULL: it takes no impulses */
    const ph_inside *inside; /* NULL: it has no state events */
    ph_share share;
    ph_native native; /* of a model */
    int held;         /* whether its inputs are held over a step, not given at nodes */
    int nroom;        /* of the share, those of the native behind them */
    int nnative;
    const ph_room *rooms; /* nroom + nnative */
} ph_network_member;

/* State events of members that all land on together (as_unit/runtime/network_lander.c), or as one composed
 * declaration (composed_lander.c). */
struct ph_whole;
struct ph_composed;
typedef struct ph_lander {
    const ph_model *model; /* of the members with events, side by side, or of all members, composed */
    const struct ph_events *events;
    const char *const *names; /* of the guards */
    int n;
    const int *members;                 /* n */
    const struct ph_events *const *own; /* n: their events, which are those of the model in this order; of a
                                           composed declaration the polynomials of members with states */
    const struct ph_composed *composed; /* NULL: they land side by side */
    void *(*make)(struct ph_whole *w, const struct ph_lander *about); /* NULL: there is no memory */
    void (*release)(void *of);
    int (*land)(void *of, double t, double h, int n); /* a communication step in n equal parts; a ph_status */
    int (*start)(void *of, double t); /* common variables and inputs before the first step; NULL: by steps */
    int (*reset)(void *of);           /* NULL: nothing */
    void (*clear)(void *member);      /* the ledger of a member that is no model; NULL: there is none */
    size_t (*state_size)(const void *of); /* of what it goes on from besides the members */
    void (*save)(const void *of, void *out);
    int (*load)(void *of, const void *from);
    const char *(*fault)(const void *of, const void *from); /* as ph_state_fault */
    const struct ph_event_refusal *(*refusal)(const void *of);
} ph_lander;

/* What of the master and its shares changes with the modes of ideal switches: the constant rows of the
 * junctions, and where the entries of their matrix are. */
typedef struct ph_junction_rows {
    int nskew;
    int nnz; /* 0: the rows cannot be solved, whatever the members do */
    int capacity;
    const int *skew_row;
    const int *skew_col;
    const int *skew_entry;
    const double *skew;
    const int *colptr;
    const int *rowind;
    const int *order;
    const int *prefer;
    const int *const *entry; /* of each share */
} ph_junction_rows;

typedef struct ph_network {
    int nmember;
    const ph_network_member *members; /* nmember */
    ph_master master;                 /* without memory */
    const ph_solver *(*solver)(void);
    const void *memory; /* of the solver, without what it points to */
    size_t memory_size; /* 0: it has none */
    int nmemory;
    const ph_room *memory_rooms; /* nmemory */
    ph_rules rules;
    int nroom;
    const ph_room *rooms; /* nroom, of the master */
    ph_held held;         /* without memory; n = 0: no signals are held over a step */
    int nheld;
    const ph_room *held_rooms; /* nheld */
    int signals;               /* the first of the common variables that are signals */
    size_t room;               /* bytes of the memory of all */
    double step;               /* longest internal step, s */
    int trials;                /* steps that tell the start */
    const double *start;       /* master.ncolumn: what the first trial starts from */
    const double *free;        /* inputs of all members besides those of junctions, at the start */
    const ph_lander *lander;   /* NULL: members do not land together */
    int nrows;                 /* of junctions, by modes of switches; 0: they stay as they are */
    const ph_junction_rows *rows;
    int njunction;
    const int *junction; /* njunction+1: where the pairs of each begin */
    const int *pair;     /* places among the pairs of all members */
} ph_network;

/* `about` is a ph_network. Blocks have those of the members one after the other; parameters and inputs too,
 * inputs are held over a step. `joined` has, for the last communication step, means of the common variables
 * (master.ncolumn), of the inputs of all members (nu), the energies made at the junctions (njunction), these
 * since the start (njunction), and the sum of the sizes of what was made at each in each step, since the
 * start. The part of a report is a member's number, or nmember for the junctions. */
PH_API const ph_step_map *ph_map_network(void);

#endif
