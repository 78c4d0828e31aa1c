/* Where a step ends: guards over a trial, the first zero, the step that ends on it; the twin of
 * engine/locate.py. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "event_landing.h"

/* Guards at x (nx+1) with l->y. */
static void evaluate(const ph_landing *l, const double *x, double *g) {
    static const double hp[3] = {1.0, 1.0, 1.0};
    const ph_events *e = l->events;
    const ph_point at = {x, l->y, l->in->p, hp};
    ph_clear(g, e->n);
    for (int i = 0; i < e->ngroup; i++)
        ph_kernels[e->groups[i].kernel].value(&e->groups[i], &at, g);
}

/* l->y = [a | u] now. */
static int read(ph_landing *l) {
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
    int status = read(l);
    if (status == PH_OK)
        evaluate(l, l->in->table, g);
    return status;
}

static int armed(const ph_landing *l, int i) {
    const ph_events *e = l->events;
    for (int j = e->when_ptr[i]; j < e->when_ptr[i + 1]; j++)
        if (l->in->p[e->when_p[j]] != e->when_value[j])
            return 0;
    return 1;
}

static double zero_below(const ph_landing *l, int i, double t, double rate) {
    return ph_larger(PH_GUARD_ZERO * l->events->nominal[i], PH_GUARD_CLOCK * DBL_EPSILON * fabs(t) * rate);
}

static int fits(const ph_landing *l, int i, double rate) {
    const int direction = l->events->direction[i];
    return direction * rate > 0.0 || (direction == 0 && rate != 0.0);
}

int ph_already(ph_landing *l) {
    const ph_events *e = l->events;
    int status = ph_guard_values(l, l->now);
    l->nfired = 0;
    for (int i = 0; i < e->n && status == PH_OK; i++) {
        l->fired[i] = armed(l, i) && e->sets_ptr[i + 1] > e->sets_ptr[i] &&
                      e->direction[i] * l->now[i] > zero_below(l, i, l->t, 0.0);
        l->nfired += l->fired[i];
    }
    return status;
}

/* Takes a step of at most *h that needs no substeps, for its polynomial. */
static int tried(ph_landing *l, double *h) {
    ph_instance *in = l->in;
    for (;;) {
        const long long halved = in->count[PH_SUBSTEPS];
        int status = ph_step_exactly(in, l->t, *h, 1);
        if (status || in->count[PH_SUBSTEPS] == halved)
            return status;
        ph_load(in, l->before);
        *h /= 2;
    }
}

/* Guards on the polynomial of the step just taken, at the points between its ends: rows 1.. of l->values. */
static int inside(ph_landing *l, double h) {
    ph_instance *in = l->in;
    const ph_events *e = l->events;
    const ph_plan *p = in->model->step;
    const double *w = in->step.last;
    int status = PH_OK;
    if (e->solves)
        ph_save(in, l->after);
    memcpy(l->w, w, sizeof(double) * (size_t)p->nw);
    if (!e->solves)
        status = read(l);
    for (int m = 1; m + 1 < e->npoint && status == PH_OK; m++) {
        double *x = l->x;
        memcpy(x, l->start_x, sizeof(double) * (size_t)p->nx);
        for (int j = 0; j < e->nincrement; j++)
            x[e->polynomial_state[j]] +=
                e->fit_weights[m * p->k + e->polynomial_node[j]] * l->w[e->polynomial_w[j]];
        for (int j = 0; j < e->nstart; j++)
            x[e->polynomial_start_state[j]] += l->w[e->polynomial_start_w[j]];
        x[p->nx] = l->t + e->fit_tau[m] * h;
        if (e->solves) {
            status = ph_set_x(in, x[p->nx], x);
            status = status ? status : read(l);
        }
        if (status == PH_OK)
            evaluate(l, x, l->values + m * e->n);
    }
    if (e->solves)
        ph_load(in, l->after);
    return status;
}

static double *coefficients(const ph_landing *l, int i) {
    return l->fits + i * l->events->npoint;
}

static int degree(const ph_landing *l, int i) {
    return l->events->npoint - 1 - l->from_zero[i];
}

static double rate(const ph_landing *l, int i, double tau) {
    return ph_bernstein_slope(coefficients(l, i), degree(l, i), tau, l->from_zero[i]) / l->h;
}

/* The Bernstein coefficients of guard i from l->values. */
static void fit(ph_landing *l, int i) {
    const ph_events *e = l->events;
    const int from = l->from_zero[i], n = e->npoint - from;
    const double *matrix = from ? e->fit_divided : e->fit_whole;
    double *b = coefficients(l, i), sum = 0.0;
    for (int r = 0; r < n; r++) {
        b[r] = 0.0;
        for (int c = 0; c < n; c++) {
            const double value = l->values[(c + from) * e->n + i];
            b[r] += matrix[r * n + c] * (from ? value / e->fit_tau[c + 1] : value);
        }
    }
    if (!from) {
        b[0] = l->values[i];
        b[n - 1] = l->values[(n - 1) * e->n + i];
    }
    for (int r = 0; r < n; r++)
        sum += b[r] - b[r];
    l->looked[i] = sum == 0.0;
}

/* The step of length l->h from l->t that was taken from l->start_x: what guards do over it. */
static int look(ph_landing *l) {
    const ph_events *e = l->events;
    double *near = l->values + e->n, *end = l->values + (e->npoint - 1) * e->n;
    int any = 0, status;
    memcpy(l->values, l->start, sizeof(double) * (size_t)e->n);
    for (int i = 0; i < e->n; i++)
        any += l->looked[i] = (signed char)armed(l, i);
    status = ph_guard_values(l, end);
    if (status || !any)
        return status;
    status = inside(l, l->h);
    for (int i = 0; i < e->n && status == PH_OK; i++) {
        const double slope = fabs(near[i] - l->start[i]) / (e->fit_tau[1] * l->h);
        l->from_zero[i] = fabs(l->start[i]) <= zero_below(l, i, l->t, slope);
        if (l->looked[i])
            fit(l, i);
    }
    return status;
}

/* Guards that are zero at the start and are on the other side from there on, into l->fired; how many. */
static int leaving(ph_landing *l) {
    const ph_events *e = l->events;
    const double *near = l->values + e->n;
    ph_crossing at;
    int n = 0;
    for (int i = 0; i < e->n; i++) {
        l->fired[i] = l->looked[i] && l->from_zero[i] && e->direction[i] * near[i] > 0.0 &&
                      (!ph_first_crossing(coefficients(l, i), degree(l, i), e->direction[i], 1, &at) ||
                       at.tau < PH_PILE_UP);
        n += l->fired[i];
    }
    return n;
}

static int first(const ph_landing *l, const signed char *refused, ph_crossing *best) {
    int found = -1;
    for (int i = 0; i < l->events->n; i++) {
        ph_crossing at;
        if (!l->looked[i] || refused[i] ||
            !ph_first_crossing(coefficients(l, i), degree(l, i), l->events->direction[i], l->from_zero[i],
                               &at))
            continue;
        if (found < 0 || at.tau < best->tau) {
            found = i;
            *best = at;
        }
    }
    return found;
}

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
            const double slope = rate(l, j, length / l->h);
            const double close = zero_below(l, j, l->t + length, fabs(slope));
            l->fired[j] =
                fabs(l->now[j]) <= ph_larger(PH_GUARD_TOGETHER * e->nominal[j], close) && fits(l, j, slope);
        }
        l->nfired += l->fired[j];
    }
}

/* The trial: *leaves: how many guards happen at once, and no step is taken. */
static int try_step(ph_landing *l, int *leaves) {
    for (int shorter = 0;; shorter++) {
        int status = tried(l, &l->h);
        status = status ? status : look(l);
        if (status)
            return status;
        *leaves = leaving(l);
        if (!*leaves)
            return PH_OK;
        ph_load(l->in, l->before);
        if (shorter == PH_LEAVING_HALVINGS)
            return PH_OK;
        l->h /= 2;
    }
}

/* One accepted step from l->t, at most h long: its length (0: none was taken); the events at its end are in
 * l->fired. */
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
    status = status ? status : try_step(l, &l->nfired);
    if (status || l->nfired)
        return status;
    memset(l->refused, 0, (size_t)e->n);
    while ((i = first(l, l->refused, &at)) >= 0) {
        status = land(l, i, &at, length);
        if (status)
            return status;
        if (*length > 0.0) {
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
    for (i = 0; i < e->n; i++) {
        const double slope = l->looked[i] ? rate(l, i, 1.0) : 0.0;
        const double end = l->values[(e->npoint - 1) * e->n + i];
        l->fired[i] =
            l->looked[i] && fabs(end) <= zero_below(l, i, l->t + l->h, fabs(slope)) && fits(l, i, slope);
        l->nfired += l->fired[i];
    }
    return PH_OK;
}
