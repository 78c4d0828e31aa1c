/* State events of the unit of a network, which happen within the steps of its map. Only units of networks
 * with state events have this file. */
#include "network_landing.h"

#include "events.h"
#include "network_whole.h"

int fmu_network_create(fmu *f) {
    (void)f;
    return 1;
}

void fmu_network_release(fmu *f) {
    (void)f;
}

int fmu_network_step(fmu *f, double t, double h, int n, int *stopped) {
    const ph_whole *w = f->of;
    const int status = f->map->step_parts(f->of, t, h, n);
    (void)stopped;
    if (status == PH_OK && w->happened.count)
        fmu_happened(f, w->happened.count, w->happened.last, w->happened.energy, w->happened.lost);
    return status;
}

int fmu_network_refused(const fmu *f, const char *function) {
    const ph_whole *w = f->of;
    const ph_lander *lander = w->about->lander;
    const ph_inside *inside;
    if (lander)
        return fmu_event_refused(f, function, lander->refusal(w->lander), lander->events->n, lander->names);
    inside = w->about->members[w->part].inside;
    return fmu_event_refused(f, function, inside->refusal(w->members[w->part].inside), inside->events->n,
                             inside->names);
}
