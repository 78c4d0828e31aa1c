/* Coupled members as one: their memory, what is saved of it; the private part of network_map.c. */
#ifndef PH_NETWORK_WHOLE_H
#define PH_NETWORK_WHOLE_H

#include <string.h>

#include "network.h"

/* A member, its memory, owned, and where its entries begin among those of all. */
typedef struct ph_whole_member {
    const ph_step_map *map;
    const void *about;  /* of the map */
    void *of;           /* what takes its steps */
    ph_instance *in;    /* the same, if that is a model's */
    ph_impulses *kicks; /* or NULL */
    void *chain;        /* an instance for derivatives, or NULL */
    void *states;       /* where it was: two of the instance, one of the impulses */
    void *inside;       /* what lands on its state events, owned, or NULL */
    ph_native native;
    int offset[PH_NBLOCK + 1]; /* in its table */
    int first[PH_NBLOCK];      /* in the table of all */
    ph_sizes sizes;
    int u, p, pairs, comp; /* first of its inputs, parameters, pairs, components */
} ph_whole_member;

typedef struct ph_whole {
    const ph_network *about;
    ph_master master;
    ph_held held;
    ph_share *shares;
    ph_whole_member *members;
    ph_sizes sizes;
    int offset[PH_NBLOCK + 1];
    double *table;
    double *row[PH_NROW];
    double *p;
    double *free;
    double *mean;   /* ncolumn: of the last step, which is where the next one starts from */
    double *begin;  /* ncolumn: at an instant */
    double *none;   /* zeros: inputs that are not among those of a member */
    double *joined; /* see network.h */
    double *kept;   /* of the internal steps before */
    char *before;   /* a saved state */
    double *h;      /* of the last step; 0: the next one is not its continuation */
    void *room;     /* memory of the master, owned, as those below */
    void *lu;
    void *memory; /* of the solver */
    double *work; /* what the pointers below and above are in */
    int begun;    /* the junctions are those of the start under the present values */
    int sampled;  /* held signals are what their sources tell */
    long long *count;
    ph_happened happened; /* in the last communication step */
    void *lander;         /* owned, or NULL */
    int set;              /* 1: values were set since the last step, so that guards may be beyond zero */
    ph_report report;
    int part;
} ph_whole;

/* network_map.c: one internal step, which begins at t + number*h; what comes is not the continuation of the
 * last step; common variables at `begin` in all of the step, signals as their sources tell them; the rows of
 * the junctions are number `rows` from now on; who refused, and why.
 */
int ph_whole_step(ph_whole *w, double t, double h, int number);
void ph_whole_changed(ph_whole *w);
int ph_whole_present(ph_whole *w, const double *begin);
int ph_whole_enter(ph_whole *w, int rows);
int ph_whole_refused(ph_whole *w, int status, double t, double h);

static inline void ph_copy(double *to, const double *from, int n) {
    if (n > 0)
        memcpy(to, from, sizeof(double) * (size_t)n);
}

/* network_memory.c: memory, laid out, 0 if there is none. */
int ph_whole_make(ph_whole *w);
void ph_whole_release(void *of);

/* network_state.c: the map of a member and what is constant of it, sizes of all members together, length of
 * `joined`. */
const ph_step_map *ph_whole_map(const ph_network_member *m, const void **about);
void ph_whole_sizes(const void *about, ph_sizes *s);
int ph_whole_njoined(const ph_network *n, int nu);
/* Blocks, and parameters, of the members side by side. */
void ph_whole_gather(ph_whole *w);
void ph_whole_gather_parameters(ph_whole *w);
/* As the functions of ph_step_map; bytes of the impulses of a member. */
size_t ph_whole_values_size(const ph_whole *w, int i);
int ph_whole_kept_size(const void *about);
void ph_whole_keep(const void *of, double *kept);
void ph_whole_join(void *of, const double *kept, double part);
size_t ph_whole_state_size(const void *of);
int ph_whole_save(void *of, void *out);
/* The same without what the lander goes on from, which is at the end. */
size_t ph_whole_placed_size(const ph_whole *w);
int ph_whole_put(ph_whole *w, void *out);
int ph_whole_back(ph_whole *w, const void *from);
int ph_whole_load(void *of, const void *from);
const char *ph_whole_state_fault(const void *of, const void *from);
int ph_whole_returns(const void *about);
void ph_whole_forget(void *of, void *state);
int ph_whole_held_size(void *of, void *state, size_t *n);
int ph_whole_write_held(void *of, void *state, char *bytes);
int ph_whole_read_held(void *of, void *state, const char *bytes, size_t n);

#endif
