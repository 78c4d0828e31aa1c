/* State events of a unit: communication steps end on the zeros of guards inside, and are told as one. Only
 * units with state events have this file. */
#include <stdlib.h>
#include <string.h>

#include "events.h"
#include "fmu.h"
#include "pool.h"

/* What an event is written to, and the memory of the landing. */
typedef struct landed {
    ph_landing *landing;
    ph_landed out;
    double t;
    int step;
} landed;

int fmu_landing_create(fmu *f) {
    const ph_events *events = f->about->landing->events;
    const size_t nc = (size_t)f->sizes.ncomp, signals = (size_t)f->offset[PH_NBLOCK];
    const size_t size = ph_padded(ph_landing_size(f->of, events));
    char *block =
        calloc(1, ph_padded(sizeof(landed)) + size + sizeof(double) * (2 * nc + signals) + (size_t)events->n);
    landed *l = (landed *)(void *)block;
    double *place;
    if (!block)
        return 0;
    place = (double *)(void *)(block + ph_padded(sizeof(landed)) + size);
    l->landing = ph_landing_init(block + ph_padded(sizeof(landed)), f->of, events);
    l->out.event_t = &l->t;
    l->out.event_step = &l->step;
    l->out.event_energy = place;
    l->out.event_lost = place + nc;
    l->out.event_signals = place + 2 * nc;
    l->out.event_fired = (signed char *)(void *)(place + 2 * nc + signals);
    f->landed = l;
    return 1;
}

void fmu_landing_release(fmu *f) {
    free(f->landed);
}

ph_landed *fmu_landing_out(const fmu *f) {
    landed *l = f->landed;
    return &l->out;
}

void fmu_landing_book(fmu *f, const ph_landed *out) {
    fmu_happened(f, 1, *out->event_t, out->event_energy, out->event_lost);
}

int fmu_landing_step(fmu *f, double t, double h, int n, int *stopped) {
    landed *l = f->landed;
    int status = ph_land_begin(l->landing, t, h, n);
    while (status == PH_OK && !l->out.done) {
        status = ph_land_on(l->landing, &l->out);
        if (status || !l->out.events)
            continue;
        fmu_landing_book(f, &l->out);
        if (stopped && !l->out.done && l->t > t) {
            *stopped = 1;
            break;
        }
    }
    l->out.done = 0;
    return status;
}

int fmu_landing_refused(const fmu *f, const char *function) {
    const landed *l = f->landed;
    return fmu_event_refused(f, function, ph_land_refusal(l->landing), f->about->landing->events->n,
                             f->about->landing->names);
}
