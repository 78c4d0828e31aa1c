/* Steps of a network, lent to a model that has the states of its members, or of some, and lands for them. */
#ifndef PH_LENT_NETWORK_H
#define PH_LENT_NETWORK_H

#include "events.h"
#include "network_whole.h"

typedef struct ph_lent_network {
    const ph_lander *about;
    ph_whole *w;
    ph_instance *in; /* of the model */
    double *x, *p;   /* of the members, as the model has them: work, the caller's */
    char *before;    /* where the network was when a trial began, owned */
    ph_lent_steps steps;
    double begun; /* of the communication step */
    int told;     /* 1: a step of it was taken */
    int refused;  /* status of the last step of the network */
} ph_lent_network;

/* 0: there is no memory. `steps` are those of all functions below, whose world is `l`. */
int ph_lent_make(ph_lent_network *l, ph_whole *w, const ph_lander *about);
void ph_lent_release(ph_lent_network *l);
/* Member number i of those whose states the model has. */
const ph_whole_member *ph_lent_member(const ph_lent_network *l, int i);
/* x and p are those of the members; the model has the states at t. */
void ph_lent_gather(ph_lent_network *l);
int ph_lent_states(ph_lent_network *l, double t);
/* A step of all members, after which the model has their states. */
int ph_lent_step(void *world, double t, double h);
/* Means and energies of member number i are those of the communication step again. */
void ph_lent_tell(const ph_lent_network *l, int i);
/* The step from t that was taken, and those of the communication step before it, together; `now`: its end. */
void ph_lent_join(ph_lent_network *l, double t, double now);
/* An event at t: by component of the model, what it made of stored energy, and lost. */
void ph_lent_book(const ph_lent_network *l, double t, const double *energy, const double *lost);
/* A communication step in n equal parts, each by grid_step(l, t, end); a ph_status. */
int ph_lent_land(ph_lent_network *l, double t, double h, int n,
                 int (*grid_step)(ph_lent_network *l, double t, double end));

#endif
