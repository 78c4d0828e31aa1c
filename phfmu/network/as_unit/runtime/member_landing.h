/* State events inside the steps of a member of a network. */
#ifndef PH_MEMBER_LANDING_H
#define PH_MEMBER_LANDING_H

#include "events.h"
#include "network.h"

/* Functions of ph_inside. */
void *ph_inside_make(const ph_inside *about, const ph_native *native);
const ph_kind *ph_inside_kind(const void *of);
const ph_happened *ph_inside_happened(const void *of);
const ph_event_refusal *ph_inside_refusal(const void *of);

#endif
