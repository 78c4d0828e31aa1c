/* State events of a unit: communication steps end on the zeros of guards inside, and are told as one. Only
 * units with state events have this file. */
#include <stdio.h>
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
    for (int c = 0; c < f->sizes.ncomp; c++) {
        f->books.jumped[c] += out->event_energy[c];
        f->phase.happened[2] += out->event_lost[c];
    }
    f->phase.happened[0]++;
    f->phase.happened[1] = *out->event_t;
    f->phase.crossed = 1;
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

/* In the order of ph_event_reason; texts with the numbers of the refusal where it has some. */
static void reason(const ph_event_refusal *r, char *text, size_t size) {
    switch (r->reason) {
    case PH_REFUSED_DEPENDENT:
        snprintf(text, size, "their jumps depend on each other");
        break;
    case PH_REFUSED_MOST:
        snprintf(text, size, "it would jump with |c| = %.6g, more than its most = %.6g", r->value, r->limit);
        break;
    case PH_REFUSED_GAIN:
        snprintf(text, size, "their jumps together gain %.6g J: their restitutions differ", r->value);
        break;
    case PH_REFUSED_PILE:
        snprintf(text, size, "%d events fall into one step: the model does not say where they come to rest",
                 PH_MOST_EVENTS);
        break;
    case PH_REFUSED_SLIDES:
        snprintf(
            text, size,
            "%d events fall into one step, at one instant: the model does not say where a bounce comes to "
            "rest, or it slides",
            PH_MOST_EVENTS);
        break;
    default:
        snprintf(text, size, "it happens again at the same instant, after each event was tried");
    }
}

int fmu_landing_refused(const fmu *f, const char *function) {
    const landed *l = f->landed;
    return fmu_landing_told(f, function, ph_land_refusal(l->landing));
}

int fmu_landing_told(const fmu *f, const char *function, const ph_event_refusal *r) {
    char text[192], names[256] = "";
    size_t used = 0;
    for (int i = 0; i < f->about->landing->events->n && used < sizeof(names); i++)
        if (r->fired[i])
            used += (size_t)snprintf(names + used, sizeof(names) - used, "%s'%s'", used ? ", " : "",
                                     f->about->landing->names[i]);
    reason(r, text, sizeof(text));
    return fmu_say(f, FMU_DISCARD, FMU_LOG_ERRORS,
                   "%s: %s. At t = %.9g s %s: %s. The component is back at t = %.9g s", function,
                   ph_status_text(PH_EVENT), r->t, names, text, fmu_time(f));
}
