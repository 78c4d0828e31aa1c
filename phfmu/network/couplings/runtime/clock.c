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

/* Shortest mean of some laps, since what else the machine does makes none shorter. */
static double seconds_of_a_lap(void) {
    enum { ROUNDS = 50, LAPS = 100 };
    double spent[PH_NPART] = {0}, least = 0;
    ph_clock c = {spent, seconds(), 0, PH_JOINING};
    for (int round = 0; round < ROUNDS; round++) {
        const double before = seconds();
        for (int i = 0; i < LAPS; i++)
            ph_clock_lap(&c, PH_JOINING);
        const double mean = (c.last - before) / LAPS;
        least = round && least < mean ? least : mean;
    }
    return least;
}

void ph_clock_start(ph_clock *c) {
    if (c->lap == 0)
        c->lap = seconds_of_a_lap();
    c->last = seconds();
    c->part = PH_JOINING;
}

void ph_clock_lap(ph_clock *c, ph_part next) {
    const double now = seconds();
    c->spent[c->part] += now - c->last - c->lap;
    c->spent[PH_READING] += c->lap;
    c->last = now;
    c->part = (int)next;
}
