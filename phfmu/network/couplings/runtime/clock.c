/* Time that passes, since a reading of it costs a tenth of one of the time of a thread. */
#define _POSIX_C_SOURCE 199309L
#include "clock.h"

#include <time.h>

static double seconds(void) {
    struct timespec now;
#ifdef CLOCK_MONOTONIC
    clock_gettime(CLOCK_MONOTONIC, &now);
#else
    timespec_get(&now, TIME_UTC);
#endif
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

void ph_clock_start(ph_clock *c) {
    c->last = seconds();
    c->part = PH_JOINING;
}

void ph_clock_lap(ph_clock *c, ph_part next) {
    const double now = seconds();
    c->spent[c->part] += now - c->last;
    c->last = now;
    c->part = (int)next;
}
