/* Where the time of the master goes: seconds of its parts, each from one lap to the next, without those of
 * the laps. */
#ifndef PH_CLOCK_H
#define PH_CLOCK_H

#include "phfmu.h"

typedef enum ph_part {
    PH_JOINING,    /* rows, matrix, what is recorded */
    PH_STEPPING,   /* functions of members: steps, derivatives */
    PH_EXCHANGING, /* functions of members: states, inputs, outputs */
    PH_SOLVING,    /* of the interface and the impulses */
    PH_READING,    /* of the clock itself */
    PH_NPART
} ph_part;

typedef struct ph_clock {
    double *spent; /* PH_NPART */
    double last;
    double lap; /* seconds of a lap, which falls upon the part that it ends; 0: not measured yet */
    int part;
} ph_clock;

/* From here on, in the first part. */
void ph_clock_start(ph_clock *c);
/* The part that ends, and what comes; of no clock nothing. */
void ph_clock_lap(ph_clock *c, ph_part next);

static inline void ph_lap(ph_clock *c, ph_part next) {
    if (c)
        ph_clock_lap(c, next);
}

#endif
