/* Refused state events of members that land as one composed declaration, in words. */
#include "composed_refusal.h"

#include "composed_lander.h"
#include "fmu_modes.h"
#include "network_landing.h"
#include "network_whole.h"

int fmu_composed_refused(const fmu *f, const char *function) {
    const ph_whole *w = f->of;
    const ph_composed *composed = w->about->lander->composed;
    const ph_mode_refusal *why = ph_composed_mode_refusal(w->lander);
    if (!why)
        return fmu_network_refused(f, function);
    return fmu_mode_refused(f, function, why, composed->switches->n, composed->names);
}
