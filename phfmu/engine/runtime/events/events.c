/* Grid steps with state events: what is located and what happens, written to the caller. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "event_landing.h"

/* A step of l, recorded; l->before is where to come back to. */
static int recorded(ph_landing *l, const ph_record *r, ph_landed *out) {
    ph_instance *in = l->in;
    double spent[2], length;
    int status = ph_locate(l, l->stop - l->t, &length);
    if (status == PH_OK && length > 0.0 && (r->signals.data || r->energy.data))
        status = ph_refresh(in);
    if (status) {
        ph_trial_back(l);
        return status;
    }
    if (length == 0.0)
        return PH_OK;
    spent[0] = (double)(in->count[PH_ITERATIONS] - l->counted[0]);
    spent[1] = (double)(in->count[PH_SOLVES] - l->counted[1]);
    if (r->counts.data)
        memcpy(r->counts.data + out->steps * r->counts.stride, spent, sizeof(spent));
    l->counted[0] = in->count[PH_ITERATIONS];
    l->counted[1] = in->count[PH_SOLVES];
    ph_write_row(in, r, out->steps);
    out->t[out->steps] = l->t;
    out->h[out->steps] = length;
    out->steps++;
    l->t = length == l->stop - l->t ? l->stop : l->t + length;
    return PH_OK;
}

static int begin(ph_landing *l) {
    l->t = l->t0 + (double)l->k * l->grid;
    l->stop = isnan(l->until) ? l->t0 + (double)(l->k + 1) * l->grid : l->until;
    l->happened = l->passes = l->nfired = 0;
    l->under_way = 1;
    for (int i = 0; i < l->events->n; i++)
        l->last[i] = -INFINITY;
    if (!l->changed)
        return PH_OK;
    l->changed = 0;
    return ph_begun(l, l->stop - l->t);
}

static int stops(const ph_landing *l) {
    int found = 0;
    for (int i = 0; l->stops && i < l->events->n; i++)
        found = found || (l->fired[i] && l->stops[i]);
    return found;
}

/* The events in l->fired, and those that follow at once; 0 in *room: there is no room for the next. */
static int happen(ph_landing *l, ph_landed *out, int *room) {
    *room = 1;
    while (l->nfired) {
        int status;
        *room = out->events < out->events_room;
        if (!*room)
            return PH_OK;
        l->happened++;
        if (++l->passes > l->events->n + 1)
            return ph_refuse_event(l, PH_REFUSED_AGAIN, 0.0, 0.0);
        l->stopped = stops(l);
        if (l->stopped) {
            *room = 0;
            return PH_OK;
        }
        status = ph_happen(l, out);
        status = status ? status : ph_already(l);
        if (status)
            return status;
    }
    l->passes = 0;
    return PH_OK;
}

int ph_land(ph_landing *l, const ph_record *record, ph_landed *out) {
    out->steps = out->events = out->done = 0;
    return ph_land_more(l, record, out);
}

int ph_land_more(ph_landing *l, const ph_record *record, ph_landed *out) {
    l->counted[0] = l->in->count[PH_ITERATIONS];
    l->counted[1] = l->in->count[PH_SOLVES];
    for (; l->k < l->end; l->k++, l->under_way = 0) {
        int status = l->under_way ? PH_OK : begin(l), room;
        for (;;) {
            double least;
            status = status ? status : happen(l, out, &room);
            if (status || !room)
                return status;
            least = l->happened ? PH_REST_OF_STEP * DBL_EPSILON * ph_larger(fabs(l->t), fabs(l->stop)) : 0.0;
            if (l->stop - l->t <= least)
                break;
            if (out->steps == out->steps_room || (out->pause && out->events))
                return PH_OK;
            status = recorded(l, record, out);
        }
    }
    out->done = 1;
    return PH_OK;
}

double *ph_land_rates(const ph_landing *l) {
    return l->rates;
}

void ph_land_stops(ph_landing *l, const signed char *stops) {
    l->stops = stops;
}

const signed char *ph_land_stopped(const ph_landing *l, double *t, int *happened) {
    *t = l->t;
    *happened = l->happened;
    return l->stopped ? l->fired : NULL;
}

/* Take the part of a communication step that was taken so far from the landing `from`. */
static void take_told(ph_landing *l, const ph_landing *from) {
    l->told = from->told;
    l->told_from = from->told_from;
    l->told_until = from->told_until;
    memcpy(l->kept, from->kept, sizeof(double) * (size_t)ph_kept_size(l->in->model));
}

int ph_land_after(ph_landing *l, const ph_landing *from) {
    l->t0 = from->t0;
    l->grid = from->grid;
    l->k = from->k;
    l->end = from->end;
    l->t = from->t;
    l->stop = from->stop;
    l->until = from->until;
    l->happened = from->happened;
    l->passes = from->passes;
    if (l != from)
        memcpy(l->rates, from->rates, sizeof(double) * (size_t)l->events->n);
    for (int i = 0; i < l->events->n; i++)
        l->last[i] = from->fired[i] ? from->t : from->last[i];
    l->changed = l->stopped = 0;
    l->under_way = 1;
    if (l != from)
        take_told(l, from);
    return ph_already(l);
}

void ph_land_from(ph_landing *l, double t0, double h, int first_step, int n, int changed) {
    l->t0 = t0;
    l->grid = h;
    l->k = first_step;
    l->end = (long long)first_step + n;
    l->until = NAN;
    l->changed = changed;
    l->under_way = l->stopped = 0;
    ph_clear(l->rates, l->events->n); /* what was landed on before is nothing of the state */
}

void ph_land_to(ph_landing *l, double t, double end, int changed) {
    l->t0 = t;
    l->grid = end - t;
    l->until = end;
    l->k = 0;
    l->end = 1;
    l->changed = changed;
    l->under_way = l->stopped = 0;
}

void ph_land_lent(ph_landing *l, const ph_lent_steps *steps) {
    l->lent = steps;
}
