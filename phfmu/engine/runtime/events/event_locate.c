/* Where a step ends: the first zero of a guard, the step that ends on it; the twin of
 * engine/landing/locate.py. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "event_landing.h"

/* *length: of the step at whose end guard i is zero, taken; 0 if there is none. */
static int land(ph_landing *l, int i, const ph_crossing *at, double *length) {
    ph_instance *in = l->in;
    const double whole = l->h, sign = at->slope > 0.0 ? 1.0 : at->slope < 0.0 ? -1.0 : 0.0;
    double h = at->tau * whole, slope = at->slope / whole, low = 0.0, last_h = NAN, last_g = NAN;
    double high = l->values[(l->events->npoint - 1) * l->events->n + i] * sign > 0.0 ? whole : INFINITY;
    *length = 0.0;
    for (int trials = 1; trials <= PH_LANDING_TRIALS * (isinf(high) ? 1 : PH_LANDING_BRACKETED); trials++) {
        double g, change;
        int status;
        ph_load(in, l->before);
        status = ph_step_exactly(in, l->t, h, 1);
        status = status ? status : ph_guard_values(l, l->now);
        if (status)
            return status;
        g = l->now[i];
        if (h != last_h && g != last_g && !isnan(last_h)) {
            const double secant = (g - last_g) / (h - last_h);
            slope = secant * sign > 0.0 ? secant : slope;
        }
        change = slope != 0.0 ? -g / slope : INFINITY;
        if (fabs(change) <= PH_LANDED * DBL_EPSILON * ph_larger(fabs(l->t + h), h)) {
            *length = h;
            return PH_OK;
        }
        if (g * sign > 0.0)
            high = h;
        else
            low = h;
        last_h = h;
        last_g = g;
        if (isinf(high)) {
            if (!(0.0 < h + change && h + change <= whole * (1 + 1e-9)))
                return PH_OK;
            h = h + change < whole ? h + change : whole;
        } else {
            const int slow = trials > PH_LANDING_TRIALS && trials % 2;
            h = slow || !(low < h + change && h + change < high) ? (low + high) / 2 : h + change;
        }
    }
    return PH_OK;
}

/* Guard i and those that are zero with it at the end of the landed step, into l->fired. */
static void together(ph_landing *l, int i, double length) {
    const ph_events *e = l->events;
    l->nfired = 0;
    for (int j = 0; j < e->n; j++) {
        l->fired[j] = j == i;
        if (j != i && l->looked[j] && !l->from_zero[j]) {
            const double slope = ph_guard_rate(l, j, length / l->h);
            const double close = ph_zero_below(l, j, l->t + length, fabs(slope));
            l->fired[j] = fabs(l->now[j]) <= ph_larger(PH_GUARD_TOGETHER * e->nominal[j], close) &&
                          ph_fits_direction(l, j, slope);
        }
        l->nfired += l->fired[j];
    }
}

int ph_locate(ph_landing *l, double h, double *length) {
    ph_instance *in = l->in;
    const ph_events *e = l->events;
    ph_crossing at;
    int status, i, any = 0;
    *length = 0.0;
    l->h = h;
    ph_save(in, l->before);
    memcpy(l->start_x, in->table, sizeof(double) * (size_t)in->model->step->nx);
    status = ph_guard_values(l, l->start);
    status = status ? status : ph_try_step(l, &l->nfired);
    if (status || l->nfired)
        return status;
    memset(l->refused, 0, (size_t)e->n);
    while ((i = ph_first_zero(l, l->refused, &at)) >= 0) {
        status = land(l, i, &at, length);
        if (status)
            return status;
        if (*length > 0.0) {
            ph_arrive(l);
            together(l, i, *length);
            return PH_OK;
        }
        l->refused[i] = 1; /* the step map has no such zero: the guard only touches it */
        any = 1;
    }
    if (any) {
        ph_load(in, l->before);
        status = ph_step_exactly(in, l->t, l->h, 1);
        if (status)
            return status;
    }
    *length = l->h;
    ph_arrive(l);
    for (i = 0; i < e->n; i++) {
        const double slope = l->looked[i] ? ph_guard_rate(l, i, 1.0) : 0.0;
        const double end = l->values[(e->npoint - 1) * e->n + i];
        l->fired[i] = l->looked[i] && fabs(end) <= ph_zero_below(l, i, l->t + l->h, fabs(slope)) &&
                      ph_fits_direction(l, i, slope);
        l->nfired += l->fired[i];
    }
    return PH_OK;
}
