/* A step that is tried, and what guards do over it on its collocation polynomial. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "event_landing.h"

int ph_trial_step(ph_landing *l, double h) {
    return l->lent ? l->lent->step(l->lent->world, l->t, h) : ph_step_exactly(l->in, l->t, h, 1);
}

void ph_trial_begin(ph_landing *l) {
    ph_save(l->in, l->before);
    memcpy(l->start_x, l->in->table, sizeof(double) * (size_t)l->in->model->step->nx);
    if (l->lent)
        l->lent->save(l->lent->world);
}

void ph_trial_back(ph_landing *l) {
    ph_load(l->in, l->before);
    if (l->lent)
        l->lent->load(l->lent->world);
}

static long long halved(const ph_landing *l) {
    return l->lent ? l->lent->halved(l->lent->world) : l->in->count[PH_SUBSTEPS];
}

/* Takes a step of at most *h that needs no substeps, for its polynomial. */
static int tried(ph_landing *l, double *h) {
    for (;;) {
        const long long before = halved(l);
        int status = ph_trial_step(l, *h);
        if (status || halved(l) == before)
            return status;
        ph_trial_back(l);
        *h /= 2;
    }
}

void ph_events_inside(const ph_events *e, int k, int m, const double *w, double *x) {
    for (int j = 0; j < e->nincrement; j++)
        x[e->polynomial_state[j]] += e->fit_weights[m * k + e->polynomial_node[j]] * w[e->polynomial_w[j]];
    for (int j = 0; j < e->nstart; j++)
        x[e->polynomial_start_state[j]] += w[e->polynomial_start_w[j]];
}

/* The states at point m of the step just taken, from those at its start in x. */
static void between(const ph_landing *l, int m, double *x) {
    const ph_events *e = l->events;
    if (l->lent)
        l->lent->inside(l->lent->world, e->fit_tau[m], x);
    else
        ph_events_inside(e, l->in->model->step->k, m, l->w, x);
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
        status = ph_read_guarded(l);
    for (int m = 1; m + 1 < e->npoint && status == PH_OK; m++) {
        double *x = l->x;
        memcpy(x, l->start_x, sizeof(double) * (size_t)p->nx);
        between(l, m, x);
        x[p->nx] = l->t + e->fit_tau[m] * h;
        if (e->solves) {
            status = ph_set_x(in, x[p->nx], x);
            status = status ? status : ph_read_guarded(l);
        }
        if (status == PH_OK)
            ph_guards_at(l, x, l->values + m * e->n);
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

double ph_guard_rate(const ph_landing *l, int i, double tau) {
    return ph_bernstein_slope(coefficients(l, i), degree(l, i), tau, l->from_zero[i]) / l->h;
}

/* The Bernstein coefficients of guard i from l->values. */
static void fit(ph_landing *l, int i) {
    const ph_events *e = l->events;
    const int from = l->from_zero[i], n = e->npoint - from;
    const double *matrix = from ? e->fit_divided : e->fit_whole;
    double *b = coefficients(l, i);
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
    l->looked[i] = (signed char)ph_finite(b, n);
}

/* l->moved from l->values. */
static void move(ph_landing *l) {
    const ph_events *e = l->events;
    for (int i = 0; i < e->n; i++) {
        l->moved[i] = 0.0;
        for (int m = 1; m < e->npoint; m++) {
            const double *at = l->values + m * e->n + i;
            const double rate = fabs(at[0] - at[-e->n]) / ((e->fit_tau[m] - e->fit_tau[m - 1]) * l->h);
            l->moved[i] = rate > l->moved[i] ? rate : l->moved[i];
        }
        if (!isfinite(l->moved[i]))
            l->moved[i] = 0.0;
    }
}

/* 1 if a guard may turn back before its end, or has left zero, so that its rates at the end are wanted. */
static int approaches(ph_landing *l, const double *end) {
    const ph_events *e = l->events;
    ph_clear(l->slopes + e->n, e->n);
    for (int i = 0; i < e->n; i++)
        if (l->looked[i] && e->rated[i] && fabs(l->slopes[i]) * l->h * PH_TURN_REACH >= fabs(l->start[i]) &&
            l->slopes[i] * end[i] < 0.0)
            return 1;
    return 0;
}

/* The step of length l->h from l->t that was taken from l->start_x: what guards do over it. */
static int look(ph_landing *l) {
    const ph_events *e = l->events;
    double *near = l->values + e->n, *end = l->values + (e->npoint - 1) * e->n;
    const int tiny = l->h <= PH_GUARD_CLOCK * DBL_EPSILON * fabs(l->t); /* guards that are zero stay so */
    int any = 0, status;
    ph_clear(l->moved, e->n);
    memcpy(l->values, l->start, sizeof(double) * (size_t)e->n);
    for (int i = 0; i < e->n; i++)
        any += l->looked[i] = (signed char)ph_armed(l, i);
    status = ph_guard_values(l, end);
    if (status || !any)
        return status;
    if (approaches(l, end))
        ph_guard_slopes(l, l->slopes + e->n);
    status = inside(l, l->h);
    for (int i = 0; i < e->n && status == PH_OK; i++) {
        const double slope = fabs(near[i] - l->start[i]) / (e->fit_tau[1] * l->h);
        l->from_zero[i] = fabs(l->start[i]) <= ph_larger(ph_zero_below(l, i, l->t, slope), ph_rounded(l, i));
        l->looked[i] = l->looked[i] && !(tiny && l->from_zero[i]);
        if (l->looked[i])
            fit(l, i);
    }
    if (status == PH_OK)
        move(l);
    return status;
}

int ph_look(ph_landing *l) {
    const int status = tried(l, &l->h);
    return status ? status : look(l);
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

/* The crossing where guard i turns back that no polynomial saw at zero, with the slope 0; one that left zero
 * crosses it again. */
static int turns(const ph_landing *l, int i, ph_crossing *at) {
    const ph_events *e = l->events;
    const double end = l->values[(e->npoint - 1) * e->n + i];
    const double begins = l->slopes[i] * l->h, ends = l->slopes[e->n + i] * l->h;
    if (l->from_zero[i]) {
        const double b[3] = {begins, 1.5 * (end - ends / 3), end};
        const double least = ph_zero_below(l, i, l->t + l->h, fabs(l->slopes[i]));
        return fabs(begins) > least && fabs(end) > least && ph_first_crossing(b, 2, e->direction[i], 1, at);
    }
    at->slope = 0.0;
    return ph_turns(l->start[i], end, begins, ends, &at->tau);
}

int ph_first_zero(const ph_landing *l, const signed char *refused, ph_crossing *best) {
    int found = -1;
    for (int i = 0; i < l->events->n; i++) {
        ph_crossing at;
        if (!l->looked[i] || refused[i] ||
            (!ph_first_crossing(coefficients(l, i), degree(l, i), l->events->direction[i], l->from_zero[i],
                                &at) &&
             !turns(l, i, &at)))
            continue;
        if (found < 0 || at.tau < best->tau) {
            found = i;
            *best = at;
        }
    }
    return found;
}

/* Marks the guards in l->fired that were inside at the ends of all steps so far; 1 if they all were. */
static int kept_inside(ph_landing *l, signed char *inside) {
    const ph_events *e = l->events;
    const double *end = l->values + (e->npoint - 1) * e->n;
    int all = 1;
    for (int i = 0; i < e->n; i++) {
        const double slope = l->fired[i] ? ph_guard_rate(l, i, 1.0) : 0.0;
        if (!l->fired[i])
            continue;
        inside[i] = inside[i] && e->direction[i] * end[i] < 0.0 &&
                    fabs(end[i]) > ph_zero_below(l, i, l->t + l->h, fabs(slope));
        all = all && inside[i];
    }
    return all;
}

int ph_try_step(ph_landing *l, int *leaves) {
    const double whole = l->h;
    signed char *inside = l->refused; /* which is used after this */
    int arc = 0;
    memset(inside, 1, (size_t)l->events->n);
    for (int shorter = 0;; shorter++) {
        int status = ph_look(l);
        if (status)
            return status;
        *leaves = arc ? 0 : leaving(l);
        if (!*leaves)
            return PH_OK;
        ph_trial_back(l);
        arc = kept_inside(l, inside) && shorter == PH_LEAVING_ARC;
        if (shorter == PH_LEAVING_HALVINGS || l->h / 2 <= PH_GUARD_ARRIVED * DBL_EPSILON * fabs(l->t)) {
            for (int i = 0; i < l->events->n; i++)
                l->rates[i] = ph_larger(l->rates[i], l->moved[i]);
            return PH_OK;
        }
        l->h = arc ? whole : l->h / 2;
    }
}

int ph_begun(ph_landing *l, double h) {
    int status;
    ph_clear(l->moved, l->events->n);
    ph_arrive(l);
    status = ph_already(l);
    if (status || !l->nfired || h == 0.0)
        return status;
    ph_trial_begin(l);
    memcpy(l->start, l->now, sizeof(double) * (size_t)l->events->n);
    l->h = h;
    if (ph_look(l) == PH_OK) /* else what it is beyond zero by is no rounding of a step */
        ph_arrive(l);
    ph_trial_back(l);
    return ph_already(l);
}
