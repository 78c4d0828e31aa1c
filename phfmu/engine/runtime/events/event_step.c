/* Communication steps with the state events in them, each told as one step: energies are sums, means are
 * means. */
#include <math.h>
#include <string.h>

#include "event_landing.h"

/* The step just taken and those before it since l->told_from, together. What is read at its end is solved for
 * from its own means. */
static int join(ph_landing *l, double from) {
    if (from > l->told_from) {
        int status = ph_refresh(l->in);
        if (status)
            return status;
        ph_join(l->in, l->kept, (from - l->told_from) / (l->t - l->told_from));
        l->in->head->parts = 0; /* a derivative of the last part would not be one of the step */
    }
    ph_keep(l->in, l->kept);
    l->told = 1;
    return PH_OK;
}

/* After an event the means are those of the step again; it has no derivative. */
void ph_land_tell(ph_landing *l) {
    l->in->head->parts = 0;
    if (!l->told)
        return;
    ph_clear_ledger(l->in);
    ph_join(l->in, l->kept, 1.0);
}

int ph_land_begin(ph_landing *l, double t, double h, int n) {
    const int plain = h == 0.0 || ph_is_sliver(l->in, t, h); /* nothing happens in it */
    if (!isfinite(t + h) || h < 0.0 || n < 1 || !(l->in->head->held || l->in->model->step->nu == 0))
        return PH_ARGUMENT;
    ph_land_from(l, t, h / n, 0, plain ? 0 : n, 1);
    l->t = l->told_from = t;
    l->told_until = t + h;
    l->told = l->nfired = 0;
    ph_save(l->in, l->begun);
    if (plain)
        return ph_step_parts(l->in, t, h, n);
    ph_clear_ledger(l->in);
    return PH_OK;
}

/* Steps until a guard is zero, or all are taken. */
static int go_on(ph_landing *l, ph_landed *out) {
    const ph_record nothing = {.parts = 1};
    double begun, length;
    ph_landed one = *out;
    one.steps_room = 1;
    one.events_room = 0;
    one.t = &begun;
    one.h = &length;
    do {
        int status = ph_land(l, &nothing, &one);
        if (status == PH_OK && one.steps)
            status = join(l, begun);
        if (status)
            return status;
    } while (!one.done && !l->nfired);
    out->done = one.done;
    return PH_OK;
}

int ph_land_on(ph_landing *l, ph_landed *out) {
    int status;
    out->steps = out->events = out->done = 0;
    status = l->nfired ? PH_OK : go_on(l, out);
    if (status == PH_OK && !out->done) {
        const ph_record nothing = {.parts = 1};
        ph_landed one = *out;
        one.steps_room = 0;
        one.events_room = 1;
        status = ph_land(l, &nothing, &one);
        out->events = one.events;
        out->done = one.done;
        if (status == PH_OK)
            ph_land_tell(l);
    }
    if (status)
        ph_load(l->in, l->begun);
    else if (out->done)
        l->in->table[l->in->model->step->nx] = l->told_until;
    return status;
}
