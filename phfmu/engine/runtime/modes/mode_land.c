/* Steps that go from mode to mode. */
#include <math.h>
#include <string.h>

#include "work.h"

/* The row of an event at t, and what it switched. */
static void tell(ph_modes *m, double t, ph_landed *out) {
    const ph_switches *sw = m->sw;
    const double *table = ph_signals(m->present->in);
    double *row = out->event_signals + out->events * (sw->told + sw->ncomp);
    memcpy(row, table, sizeof(double) * (size_t)sw->told);
    memcpy(row + sw->told, table + m->present->length - sw->ncomp, sizeof(double) * (size_t)sw->ncomp);
    out->event_t[out->events] = t;
    out->event_step[out->events] = out->steps;
    out->events++;
}

/* Rows of signals from `begin` on without what only the mode has. */
static void trim(const ph_modes *m, const ph_record *r, int begin, int end) {
    const ph_switches *sw = m->sw;
    for (int i = begin; r->signals.data && i < end; i++) {
        double *row = r->signals.data + i * r->signals.stride;
        memmove(row + sw->told, row + m->present->length - sw->ncomp, sizeof(double) * (size_t)sw->ncomp);
    }
}

/* Modes that were set, or that the state at the start asks for. */
static int settle(ph_modes *m, double t, ph_landed *out, signed char *changed) {
    const ph_switches *sw = m->sw;
    const ph_mode *mode = m->present;
    const double *p = ph_parameters(mode->in);
    signed char *own = changed + out->events * sw->n;
    double *energy = out->event_energy + out->events * sw->ncomp;
    double *lost = out->event_lost + out->events * sw->ncomp;
    int status, any = 0;
    if (!m->changed || (*m->started && memcmp(m->on, m->asked, (size_t)sw->n) == 0))
        return PH_OK;
    ph_clear(energy, sw->ncomp);
    ph_clear(lost, sw->ncomp);
    memset(out->event_fired + out->events * sw->nevent, 0, (size_t)sw->nevent);
    status = ph_mode_change(m, p, m->asked, m->grid, energy, lost, own);
    for (int j = 0; j < sw->n && status == PH_OK; j++)
        any = any || own[j];
    if (any)
        tell(m, t, out);
    return status;
}

/* The events that the present landing stopped before. */
static int happen(ph_modes *m, ph_landed *out, signed char *changed) {
    const ph_switches *sw = m->sw;
    const ph_mode *old = m->present;
    double *energy = out->event_energy + out->events * sw->ncomp;
    double *lost = out->event_lost + out->events * sw->ncomp, t;
    int count, status;
    ph_land_stopped(old->landing, &t, &count);
    status = ph_happen_jump(old->landing, energy, lost);
    if (status)
        return status;
    ph_happen_flags(old->landing, out->event_fired + out->events * sw->nevent);
    status = ph_mode_change(m, ph_happen_parameters(old->landing), NULL, m->grid, energy, lost,
                            changed + out->events * sw->n);
    if (status) {
        ph_happen_undo(old->landing);
        return status;
    }
    tell(m, t, out);
    return ph_land_after(m->present->landing, old->landing);
}

static int stopped(const ph_modes *m) {
    double t;
    int count;
    return ph_land_stopped(m->present->landing, &t, &count) != NULL;
}

void ph_modes_from(ph_modes *m, double t0, double h, int first, int n, int changed) {
    m->t0 = t0;
    m->until = NAN;
    m->grid = h;
    m->first = first;
    m->n = n;
    m->changed = changed;
    m->pending = 1;
}

void ph_modes_to(ph_modes *m, double t, double end, int changed) {
    ph_modes_from(m, t, end - t, 0, 1, changed);
    m->until = end;
}

void ph_modes_begin(ph_modes *m, double t, double h, int n) {
    ph_modes_from(m, t, h, 0, n, 1);
}

/* Nothing is written yet; the mode that it is in. */
static int begin(ph_modes *m, ph_landed *out) {
    out->steps = out->events = out->done = 0;
    m->refusal.reason = -1;
    m->entered = NULL;
    return ph_modes_present(m) ? PH_OK : PH_EVENT;
}

int ph_modes_land(ph_modes *m, const ph_record *record, ph_landed *out, signed char *changed) {
    int status = begin(m, out);
    if (status == PH_OK && m->pending) {
        status = settle(m, m->t0 + (double)m->first * m->grid, out, changed);
        if (status)
            return status;
        m->pending = 0;
        if (isnan(m->until))
            ph_land_from(m->present->landing, m->t0, m->grid, m->first, m->n, m->changed);
        else
            ph_land_to(m->present->landing, m->t0, m->until, m->changed);
        if (out->events && out->events == out->events_room)
            return status; /* others may have to follow the mode before steps are tried in it */
    }
    while (status == PH_OK && !out->done) {
        const int steps = out->steps;
        if (!stopped(m)) {
            status = ph_land_more(m->present->landing, record, out);
            trim(m, record, steps, out->steps);
        }
        if (status || out->done || !stopped(m) || out->events == out->events_room)
            break;
        status = happen(m, out, changed);
    }
    return status;
}

int ph_modes_on(ph_modes *m, ph_landed *out, signed char *changed) {
    int status = begin(m, out);
    if (status == PH_OK && m->pending) {
        const double h = m->grid;
        m->grid = h / m->n;
        status = settle(m, m->t0, out, changed);
        if (status)
            return status;
        m->pending = 0;
        status = ph_land_begin(m->present->landing, m->t0, h, m->n);
        if (out->events)
            return status;
    }
    if (status)
        return status;
    status = ph_land_on(m->present->landing, out);
    if (status || out->done || !stopped(m))
        return status;
    status = happen(m, out, changed);
    ph_land_tell(m->present->landing);
    return status;
}
