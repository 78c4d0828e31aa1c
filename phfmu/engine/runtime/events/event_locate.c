/* The end of a step: the first zero of a guard, the step that ends on it. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "event_landing.h"

/* The step of length h from l->t, taken, and guard i at its end. */
static int value_after(ph_landing *l, int i, double h, double *g) {
    int status;
    ph_trial_back(l);
    status = ph_trial_step(l, h);
    status = status ? status : ph_guard_values(l, l->now);
    *g = l->now[i];
    return status;
}

/* *length: of the step at whose end guard i is zero, taken; 0 if there is none. low, high: lengths between
 * which it changes its sign, as far as they are known. Where it goes beyond zero by more than rounding, that
 * change alone tells where it is zero. */
static int land(ph_landing *l, int i, const ph_crossing *at, double low, double high, double *length) {
    const double whole = l->h, sign = at->slope > 0.0 ? 1.0 : at->slope < 0.0 ? -1.0 : 0.0;
    double h = at->tau * whole, slope = at->slope / whole, last_h = NAN, last_g = NAN;
    const double end = l->values[(l->events->npoint - 1) * l->events->n + i] * sign;
    const double zero = ph_zero_below(l, i, l->t, 0.0);
    int passes = isfinite(high) || end > zero;
    if (isinf(high) && end > 0.0)
        high = whole;
    *length = 0.0;
    for (int trials = 1; trials <= PH_LANDING_TRIALS * (isinf(high) ? 1 : PH_LANDING_BRACKETED); trials++) {
        double g, change;
        const int status = value_after(l, i, h, &g);
        if (status)
            return status;
        if (h != last_h && g != last_g && !isnan(last_h)) {
            const double secant = (g - last_g) / (h - last_h);
            slope = secant * sign > 0.0 ? secant : slope;
        }
        change = slope != 0.0 ? -g / slope : INFINITY;
        if (g * sign > 0.0)
            high = h;
        else
            low = h;
        passes = passes || g * sign > zero;
        if (fmin(fabs(change), passes ? high - low : INFINITY) <=
            PH_LANDED * DBL_EPSILON * ph_larger(fabs(l->t + h), h)) {
            *length = h;
            return PH_OK;
        }
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

/* Land on the zero of a guard that turns back: steps that end there look for values beyond zero, by
 * parabolas. Points are lengths and distances from zero. */
static int turned(ph_landing *l, int i, const ph_crossing *at, double *length) {
    const double whole = l->h, side = l->start[i] > 0.0 ? 1.0 : -1.0;
    const double end = l->values[(l->events->npoint - 1) * l->events->n + i];
    const int back = l->events->direction[i] == (int)side; /* what counts is how it leaves */
    double left[2] = {0.0, l->start[i] * side}, right[2] = {whole, end * side}, least[2] = {0.0, INFINITY};
    double h = at->tau * whole;
    *length = 0.0;
    for (int trials = 0; trials < PH_TURN_TRIALS; trials++) {
        double now[2] = {h, 0.0}, *to;
        const int status = value_after(l, i, h, &now[1]);
        if (status)
            return status;
        now[1] *= side;
        if (now[1] < -ph_zero_below(l, i, l->t, 0.0)) {
            const double *edge = back ? right : left;
            const double part = sqrt(-now[1] / (edge[1] - now[1])), off = edge[0] - h; /* least at h */
            const ph_crossing first = {(h + part * off) / whole,
                                       2 * side * (edge[1] - now[1]) * part / off * whole};
            return land(l, i, &first, back ? h : 0.0, back ? whole : h, length);
        }
        if (now[1] < least[1]) {
            to = isinf(least[1]) ? NULL : h > least[0] ? left : right;
            if (to)
                memcpy(to, least, sizeof(least));
            memcpy(least, now, sizeof(now));
        } else {
            memcpy(h > least[0] ? right : left, now, sizeof(now));
        }
        h = ph_vertex(left, least, right);
        if (!(left[0] < h && h < right[0]) || fabs(h - least[0]) <= PH_TURN_CLOSE * whole)
            return PH_OK;
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
    const ph_events *e = l->events;
    ph_crossing at;
    int status, i, any = 0;
    *length = 0.0;
    l->h = h;
    ph_trial_begin(l);
    status = ph_guard_values(l, l->start);
    if (status == PH_OK)
        ph_guard_slopes(l, l->slopes);
    status = status ? status : ph_try_step(l, &l->nfired);
    if (status || l->nfired)
        return status;
    memset(l->refused, 0, (size_t)e->n);
    while ((i = ph_first_zero(l, l->refused, &at)) >= 0) {
        const double end = l->values[(e->npoint - 1) * e->n + i];
        *length = 0.0;
        status = at.slope == 0.0 ? PH_OK : land(l, i, &at, 0.0, INFINITY, length);
        if (status == PH_OK && *length == 0.0 && !l->from_zero[i] && l->start[i] * end > 0.0)
            status = turned(l, i, &at, length);
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
        ph_trial_back(l);
        status = ph_trial_step(l, l->h);
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
