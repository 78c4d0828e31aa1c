/* A member with state events that happen inside its steps: each step of it ends where it would, with the
 * events in it, and is told as one. Members with values at nodes land with all others instead. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "member_landing.h"
#include "pool.h"
#include "system.h"

/* The first part is what the functions of native.c are given. */
typedef struct landed_member {
    ph_native native;
    ph_kind kind;
    ph_landing *landing;
    ph_landed out;
    double t;
    int step;
    ph_happened happened;
} landed_member;

static int take_step(const ph_share *s, double t, double h);

void *ph_inside_make(const ph_inside *about, const ph_native *native) {
    const ph_events *events = about->events;
    const size_t nc = (size_t)native->in->model->step->ncomp;
    const size_t signals = (size_t)native->in->offset[PH_NBLOCK], head = ph_padded(sizeof(landed_member));
    const size_t size = ph_padded(ph_landing_size(native->in, events));
    char *block = calloc(1, head + size + sizeof(double) * (4 * nc + signals) + (size_t)events->n);
    landed_member *m = (landed_member *)(void *)block;
    double *place;
    if (!block)
        return NULL;
    place = (double *)(void *)(block + head + size);
    m->native = *native;
    m->kind = *ph_kind_native();
    m->kind.step = take_step;
    m->landing = ph_landing_init(block + head, native->in, events);
    m->out.event_t = &m->t;
    m->out.event_step = &m->step;
    m->out.event_energy = place;
    m->out.event_lost = place + nc;
    m->happened.energy = place + 2 * nc;
    m->happened.lost = place + 3 * nc;
    m->out.event_signals = place + 4 * nc;
    m->out.event_fired = (signed char *)(void *)(place + 4 * nc + signals);
    return m;
}

const ph_kind *ph_inside_kind(const void *of) {
    return &((const landed_member *)of)->kind;
}

const ph_happened *ph_inside_happened(const void *of) {
    return &((const landed_member *)of)->happened;
}

const ph_event_refusal *ph_inside_refusal(const void *of) {
    return ph_land_refusal(((const landed_member *)of)->landing);
}

/* The event that was written to m->out. */
static void note(landed_member *m) {
    m->happened.count++;
    m->happened.last = m->t;
    for (int c = 0; c < m->native.in->model->step->ncomp; c++) {
        m->happened.energy[c] += m->out.event_energy[c];
        m->happened.lost[c] += m->out.event_lost[c];
    }
}

static int take_step(const ph_share *s, double t, double h) {
    landed_member *m = s->of;
    int status = ph_set_input(m->native.in, s->u);
    m->happened.count = 0;
    ph_clear(m->happened.energy, 2 * m->native.in->model->step->ncomp);
    m->out.done = 0;
    status = status ? status : ph_land_begin(m->landing, t, h, m->native.parts);
    while (status == PH_OK && !m->out.done) {
        status = ph_land_on(m->landing, &m->out);
        if (status == PH_OK && m->out.events)
            note(m);
    }
    return status;
}
