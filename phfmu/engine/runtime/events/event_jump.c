/* Events at a zero of a guard: the states jump, parameters are set. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "event_landing.h"

static size_t lay_out(ph_landing *l, char *base) {
    const ph_events *e = l->events;
    const ph_plan *p = l->in->model->step;
    const int n = e->ncolumn, c = e->ncomponent * n;
    ph_pool part = {base, 0};
    ph_take(&part, sizeof(*l));
    l->last = ph_take_doubles(&part, e->n);
    l->rates = ph_take_doubles(&part, e->n);
    l->moved = ph_take_doubles(&part, e->n);
    l->start = ph_take_doubles(&part, e->n);
    l->now = ph_take_doubles(&part, e->n);
    l->slopes = ph_take_doubles(&part, 2 * e->n);
    l->values = ph_take_doubles(&part, e->npoint * e->n);
    l->fits = ph_take_doubles(&part, e->npoint * e->n);
    l->x = ph_take_doubles(&part, p->nx + 1);
    l->start_x = ph_take_doubles(&part, p->nx + 1);
    l->w = ph_take_doubles(&part, p->nw);
    l->y = ph_take_doubles(&part, p->na + p->nu);
    l->p = ph_take_doubles(&part, p->np);
    l->jump = ph_take_doubles(&part, n * (e->ncomponent + e->nmoved + n) + e->njump);
    l->c = ph_take_doubles(&part, c);
    l->before_c = ph_take_doubles(&part, c);
    l->s = ph_take_doubles(&part, n * n);
    l->factor = ph_take_doubles(&part, n * n);
    l->goal = ph_take_doubles(&part, n);
    l->m = ph_take_doubles(&part, n);
    l->found = ph_take_doubles(&part, n);
    l->e = ph_take_doubles(&part, n);
    l->which = ph_take_ints(&part, n);
    l->whose = ph_take_ints(&part, e->njump);
    l->acts = ph_take(&part, (size_t)n);
    l->fired = ph_take(&part, (size_t)e->n);
    l->rests = ph_take(&part, (size_t)e->n);
    l->looked = ph_take(&part, (size_t)e->n);
    l->from_zero = ph_take(&part, (size_t)e->n);
    l->refused = ph_take(&part, (size_t)e->n);
    l->before = ph_take(&part, ph_state_size(l->in));
    l->after = ph_take(&part, ph_state_size(l->in));
    l->kept = ph_take_doubles(&part, ph_kept_size(l->in->model));
    l->begun = ph_take(&part, ph_state_size(l->in));
    return part.used;
}

size_t ph_landing_size(const ph_instance *in, const ph_events *events) {
    ph_landing l = {.in = (ph_instance *)in, .events = events};
    return lay_out(&l, NULL);
}

ph_landing *ph_landing_init(void *memory, ph_instance *in, const ph_events *events) {
    ph_landing *l = memory;
    memset(memory, 0, ph_landing_size(in, events));
    l->in = in;
    l->events = events;
    lay_out(l, memory);
    l->refusal.fired = l->fired;
    return l;
}

const ph_event_refusal *ph_land_refusal(const ph_landing *l) {
    return &l->refusal;
}

static void set(double *p, const int *ptr, const int *which, const double *value, int i) {
    for (int j = ptr[i]; j < ptr[i + 1]; j++)
        p[which[j]] = value[j];
}

int ph_happen_decide(ph_landing *l) {
    ph_instance *in = l->in;
    const ph_events *e = l->events;
    const ph_plan *p = in->model->step;
    const int crowded = l->happened >= PH_MOST_EVENTS;
    int any = 0, slides = 0;
    for (int i = 0; i < e->n; i++) {
        const int piled = crowded || l->t - l->last[i] < PH_PILE_UP * l->grid;
        l->rests[i] = l->fired[i] && piled && e->rest_ptr[i + 1] > e->rest_ptr[i];
        any += l->rests[i];
        slides += l->fired[i] && l->t - l->last[i] <= PH_REST_OF_STEP * DBL_EPSILON * fabs(l->t);
    }
    if (crowded && !any)
        return ph_refuse_event(l, slides ? PH_REFUSED_SLIDES : PH_REFUSED_PILE, 0.0, 0.0);
    ph_save(in, l->before); /* where a refused event leaves the instance */
    if (p->np > 0)
        memcpy(l->p, in->p, sizeof(double) * (size_t)p->np);
    for (int i = 0; i < e->n; i++)
        if (l->fired[i])
            set(l->p, e->sets_ptr, e->sets_p, e->sets_value, i);
    for (int i = 0; i < e->n; i++)
        if (l->rests[i])
            set(l->p, e->rest_ptr, e->rest_p, e->rest_value, i);
    return PH_OK;
}

int ph_happen_jump(ph_landing *l, double *energy, double *lost) {
    int status = ph_happen_decide(l);
    if (status)
        return status;
    ph_clear(energy, l->in->model->step->ncomp);
    ph_clear(lost, l->in->model->step->ncomp);
    status = ph_jump_event(l, energy, lost);
    if (status)
        ph_happen_undo(l);
    return status;
}

void ph_happen_undo(ph_landing *l) {
    ph_load(l->in, l->before);
}

const double *ph_happen_parameters(const ph_landing *l) {
    return l->p;
}

void ph_happen_flags(const ph_landing *l, signed char *fired) {
    for (int i = 0; i < l->events->n; i++)
        fired[i] = (signed char)(l->fired[i] + l->rests[i]);
}

int ph_happen(ph_landing *l, ph_landed *out) {
    ph_instance *in = l->in;
    const ph_events *e = l->events;
    const int length = in->offset[PH_NBLOCK], ncomp = in->model->step->ncomp;
    int status =
        ph_happen_jump(l, out->event_energy + out->events * ncomp, out->event_lost + out->events * ncomp);
    if (status)
        return status;
    status = ph_set_parameters(in, l->p);
    status = status ? status : ph_initialise(in);
    if (status) {
        ph_happen_undo(l);
        return status;
    }
    ph_happen_flags(l, out->event_fired + out->events * e->n);
    for (int i = 0; i < e->n; i++)
        if (l->fired[i])
            l->last[i] = l->t;
    memcpy(out->event_signals + out->events * length, in->table, sizeof(double) * (size_t)length);
    out->event_t[out->events] = l->t;
    out->event_step[out->events] = out->steps;
    out->events++;
    return PH_OK;
}
