/* Members of a network that land on state events as the composed declaration of all of them, with ideal
 * switches or without. */
#ifndef PH_COMPOSED_LANDER_H
#define PH_COMPOSED_LANDER_H

#include "modes.h"
#include "network.h"

/* The composed declaration in a mode of its switches. */
typedef struct ph_composed_mode {
    const ph_model *model;
    const ph_events *events;
    int rows; /* of the network: ph_junction_rows */
} ph_composed_mode;

/* What is asked of it: ph_lander.composed. Its states, parameters and components are those of the members. */
typedef struct ph_composed {
    int nmode;                     /* 1 without switches */
    const ph_composed_mode *modes; /* nmode, the first one that of the start */
    const ph_switches *switches;   /* NULL: none */
    const ph_mode_rows *mode_rows; /* nmode */
    const char *const *names;      /* of the switches */
    const int *free;               /* places of its inputs among those of all members */
    const int *column;             /* algebraic variable of each common variable */
    int nrelation;
    const int *relations; /* nrelation: members that are switches and nothing else */
    const int *unknown;   /* nrelation: the first common variable of each */
    double step;          /* longest internal step, s */
} ph_composed;

/* Functions of ph_lander. */
void *ph_composed_make(struct ph_whole *w, const ph_lander *about);
void ph_composed_release(void *of);
int ph_composed_land(void *of, double t, double h, int n);
int ph_composed_start(void *of, double t);
int ph_composed_reset(void *of);
size_t ph_composed_state_size(const void *of);
void ph_composed_save(const void *of, void *out);
int ph_composed_load(void *of, const void *from);
const char *ph_composed_fault(const void *of, const void *from);
const ph_event_refusal *ph_composed_refusal(const void *of);
/* Why a change of modes was refused; NULL: it was not, ask the one before. */
const ph_mode_refusal *ph_composed_mode_refusal(const void *of);

#endif
