/* Members of a network that all land on state events together. */
#ifndef PH_NETWORK_LANDER_H
#define PH_NETWORK_LANDER_H

#include "events.h"
#include "network.h"

/* Functions of ph_lander. */
void *ph_lander_make(struct ph_whole *w, const ph_lander *about);
void ph_lander_release(void *of);
int ph_lander_land(void *of, double t, double h, int n);
double *ph_lander_rates(const void *of);
const ph_event_refusal *ph_lander_refusal(const void *of);

#endif
