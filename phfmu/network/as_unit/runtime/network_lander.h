/* Members of a network that all land on state events together. */
#ifndef PH_NETWORK_LANDER_H
#define PH_NETWORK_LANDER_H

#include "events.h"
#include "network.h"

/* Functions of ph_lander. */
void *ph_lander_make(struct ph_whole *w, const ph_lander *about);
void ph_lander_release(void *of);
int ph_lander_land(void *of, double t, double h, int n);
size_t ph_lander_state_size(const void *of);
void ph_lander_save(const void *of, void *out);
int ph_lander_load(void *of, const void *from);
const char *ph_lander_fault(const void *of, const void *from);
const ph_event_refusal *ph_lander_refusal(const void *of);

#endif
