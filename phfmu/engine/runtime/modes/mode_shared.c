/* Switches that depend on each other along directions that share no multiplier. */
#include <math.h>

#include "work.h"

/* Entry of direction d at switch i, in typical multipliers, its largest being 1. */
static double along(const ph_switches *sw, const ph_mode_rows *mode, int d, int i) {
    const double *row = mode->free_row + d * sw->na;
    const int at = sw->multiplier[i];
    double largest = 0.0;
    for (int j = 0; j < sw->na; j++)
        largest = fmax(largest, fabs(row[j] * sw->scale[j]));
    return row[at] * sw->scale[at] / largest;
}

double ph_mode_held(const ph_switches *sw, const ph_mode_rows *mode, const double *a, int j) {
    const double size = sw->scale[sw->multiplier[j]];
    double bound = INFINITY, own = 0.0;
    int direction = -1;
    if (fabs(a[sw->multiplier[j]]) > PH_ZERO * size)
        return 0.0;
    for (int d = 0; d < mode->nfree; d++) {
        const double entry = along(sw, mode, d, j);
        if (fabs(entry) <= PH_ZERO)
            continue;
        if (direction >= 0)
            return INFINITY; /* several: not told here */
        direction = d;
        own = entry;
    }
    if (direction < 0)
        return 0.0;
    for (int i = 0; i < sw->n; i++) {
        const double entry = along(sw, mode, direction, i) * (own > 0.0 ? 1.0 : -1.0);
        if (!mode->on[i] || !sw->unilateral[i])
            continue;
        for (int d = 0; d < mode->nfree; d++)
            if (d != direction && fabs(entry) > PH_ZERO && fabs(along(sw, mode, d, i)) > PH_ZERO)
                return INFINITY;
        if (entry < 0.0) {
            const int at = sw->multiplier[i];
            bound = fmin(bound, fmax(a[at] / sw->scale[at], 0.0) / -entry);
        }
    }
    /* without a bound it is a current that circulates and does nothing */
    return isinf(bound) || fabs(own) * bound <= PH_ZERO ? 0.0 : fabs(own) * bound * size;
}
