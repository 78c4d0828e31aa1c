/* Guards at an instant: their values, which of them are armed, what counts as zero. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "event_landing.h"

/* Guards at x (nx+1) with l->y. */
void ph_guards_at(const ph_landing *l, const double *x, double *g) {
    static const double hp[3] = {1.0, 1.0, 1.0};
    const ph_events *e = l->events;
    const ph_point at = {x, l->y, l->in->p, hp, l->in->step.work};
    ph_clear(g, e->n);
    for (int i = 0; i < e->ngroup; i++)
        ph_value_of(l->in->model->code, &e->groups[i], &at, g);
}

void ph_guard_slopes(const ph_landing *l, double *slopes) {
    static const double hp[3] = {1.0, 1.0, 1.0};
    const ph_events *e = l->events;
    const ph_point at = {l->in->table, l->y, l->in->p, hp, l->in->step.work};
    ph_clear(slopes, e->n);
    for (int i = 0; i < e->nrate; i++)
        ph_value_of(l->in->model->code, &e->rates[i], &at, slopes);
}

/* l->y = [a | u] now. */
int ph_read_guarded(ph_landing *l) {
    ph_instance *in = l->in;
    const ph_plan *p = in->model->step;
    int status = l->events->solves ? ph_refresh(in) : PH_OK;
    if (status)
        return status;
    if (l->events->solves)
        memcpy(l->y, in->table + in->offset[PH_A_END], sizeof(double) * (size_t)p->na);
    if (p->nu > 0)
        memcpy(l->y + p->na, in->u, sizeof(double) * (size_t)p->nu);
    return PH_OK;
}

int ph_guard_values(ph_landing *l, double *g) {
    int status = ph_read_guarded(l);
    if (status == PH_OK)
        ph_guards_at(l, l->in->table, g);
    return status;
}

int ph_armed(const ph_landing *l, int i) {
    const ph_events *e = l->events;
    for (int j = e->when_ptr[i]; j < e->when_ptr[i + 1]; j++)
        if (l->in->p[e->when_p[j]] != e->when_value[j])
            return 0;
    return 1;
}

double ph_zero_below(const ph_landing *l, int i, double t, double rate) {
    return ph_larger(PH_GUARD_ZERO * l->events->nominal[i], PH_GUARD_CLOCK * DBL_EPSILON * fabs(t) * rate);
}

double ph_rounded(const ph_landing *l, int i) {
    return PH_GUARD_ARRIVED * DBL_EPSILON * fabs(l->t) * l->rates[i];
}

void ph_arrive(ph_landing *l) {
    memcpy(l->rates, l->moved, sizeof(double) * (size_t)l->events->n);
}

int ph_fits_direction(const ph_landing *l, int i, double rate) {
    const int direction = l->events->direction[i];
    return direction * rate > 0.0 || (direction == 0 && rate != 0.0);
}

int ph_already(ph_landing *l) {
    const ph_events *e = l->events;
    int status = ph_guard_values(l, l->now);
    l->nfired = 0;
    for (int i = 0; i < e->n && status == PH_OK; i++) {
        l->fired[i] =
            ph_armed(l, i) && e->sets_ptr[i + 1] > e->sets_ptr[i] &&
            e->direction[i] * l->now[i] > ph_larger(ph_zero_below(l, i, l->t, 0.0), ph_rounded(l, i));
        l->nfired += l->fired[i];
    }
    return status;
}
