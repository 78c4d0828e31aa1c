/* Many runs of one model in compiled code: starts, steps and what is measured of each.
 *
 * Only what is measured is worked out: values of the present time are solved for if asked. The Python side
 * reads the field lists from here: one field a line.
 */
#include "runs.h"

#include "lanes.h"

#include <math.h>
#include <string.h>

enum { FIRST, LAST, MIN, MAX, PEAK, MEAN, RMS, TMIN, TMAX };
enum { PARAMETER, STATE, INPUT };

/* Stored energies are the last of the signals; what their changes add up to is at hand, the signals take a
 * solve. */
static double sum(const ph_runs *s, const double *signals, const ph_runs_measure *m) {
    const double *values = m->first < s->energy ? signals + m->first : s->now + (m->first - s->energy);
    double total = 0.0;
    for (int i = 0; i < m->count; i++)
        total += values[i];
    return total;
}

/* Stored energy from the signals: at the start, and where parameters changed it. */
static void count_stored(const ph_runs *s) {
    memcpy(s->now, ph_signals(s->in) + s->energy, sizeof(double) * (size_t)s->ncomp);
    memcpy(s->accounts->before, s->now, sizeof(double) * (size_t)s->ncomp);
    memset(s->carry, 0, sizeof(double) * (size_t)s->ncomp);
}

/* total += x, compensated by what the additions before have lost. */
static void add_to(double *total, double *carry, double x) {
    const double part = x + *carry, sum = *total + part;
    *carry = part - (sum - *total);
    *total = sum;
}

static void begin(const ph_runs *s, const double *signals, double t) {
    for (int i = 0; i < s->nmeasure; i++) {
        const ph_runs_measure *m = &s->measures[i];
        double v = sum(s, signals, m), *o = &s->value[i];
        s->held[i] = v;
        *o = m->kind == MEAN || m->kind == RMS ? 0.0 : m->kind == PEAK ? fabs(v) : v;
        s->time[i] = t;
    }
}

static void add(const ph_runs *s, const double *signals, double t, double h) {
    for (int i = 0; i < s->nmeasure; i++) {
        const ph_runs_measure *m = &s->measures[i];
        double v = sum(s, signals, m), was = s->held[i], *o = &s->value[i];
        switch (m->kind) {
        case LAST:
            *o = v;
            break;
        case PEAK:
            *o = fabs(v) > *o || isnan(v) ? fabs(v) : *o;
            break;
        case MIN:
        case TMIN:
            if (v < *o || isnan(v)) {
                *o = v;
                s->time[i] = t;
            }
            break;
        case MAX:
        case TMAX:
            if (v > *o || isnan(v)) {
                *o = v;
                s->time[i] = t;
            }
            break;
        case MEAN:
            *o += 0.5 * h * (was + v);
            break;
        case RMS:
            *o += 0.5 * h * (was * was + v * v);
            break;
        }
        s->held[i] = v;
    }
}

static void tell(const ph_runs *s, double length, double *out) {
    for (int i = 0; i < s->nmeasure; i++) {
        int kind = s->measures[i].kind;
        double v = s->value[i];
        out[i] = kind == MEAN                   ? v / length
                 : kind == RMS                  ? sqrt(v / length)
                 : kind == TMIN || kind == TMAX ? s->time[i]
                                                : v;
    }
}

/* The accounts of a run that has none yet; rows are those of the ledger of a step. */
static void open_accounts(const ph_runs *s) {
    ph_accounts *b = s->accounts;
    memset(s->books, 0, sizeof(double) * (size_t)s->nbook);
    b->violated = b->worst_unexplained = 0.0;
    b->H0 = s->was;
    b->H = s->now;
    b->varying = s->varying;
    b->stored = ph_ledger(s->in, PH_ROW_STORED);
    b->dissipated = ph_ledger(s->in, PH_ROW_DISSIPATED);
    b->supplied = ph_ledger(s->in, PH_ROW_SUPPLIED);
    b->numerical = s->loses ? ph_ledger(s->in, PH_ROW_NUMERICAL) : NULL;
    b->moved = ph_ledger(s->in, PH_ROW_MOVED);
    b->pairs = ph_ledger(s->in, PH_ROW_PAIRS);
}

/* Books the last step. H is what its changes add up to, so that it is not solved for. */
static void book(const ph_runs *s) {
    ph_accounts *b = s->accounts;
    memcpy(s->was, s->now, sizeof(double) * (size_t)s->ncomp);
    for (int k = 0; k < s->ncomp; k++) {
        const double c = s->constant[k], was = s->was[k];
        add_to(&s->now[k], &s->carry[k], b->stored[k]);
        s->varying[k] = fmin(fmax(fabs(was), fabs(s->now[k])), fmax(fabs(was - c), fabs(s->now[k] - c)));
    }
    (void)ph_account(b, 0);
    memcpy(b->before, s->now, sizeof(double) * (size_t)s->ncomp);
}

static int start(const ph_runs *s, const double *row) {
    int status = ph_reset(s->in);
    memcpy(s->p, s->p0, sizeof(double) * (size_t)s->np);
    memcpy(s->x, s->x0, sizeof(double) * (size_t)s->nx);
    memcpy(s->u, s->u0, sizeof(double) * (size_t)s->nu);
    for (int i = 0; i < s->nplace; i++) {
        const ph_runs_place *q = &s->places[i];
        (q->kind == PARAMETER ? s->p : q->kind == STATE ? s->x : s->u)[q->index] = row[q->column];
    }
    if (!status)
        status = ph_set_parameters(s->in, s->p);
    if (!status)
        status = ph_set_x(s->in, s->t0, s->x);
    if (!status)
        status = ph_set_input(s->in, s->u);
    return status ? status : ph_initialise(s->in);
}

static int change(const ph_runs *s, const ph_runs_stretch *stretch) {
    int status = 0, parameters = 0, inputs = 0;
    for (int i = stretch->change; i < stretch->until; i++) {
        const ph_runs_change *g = &s->changes[i];
        (g->kind == PARAMETER ? s->p : s->u)[g->index] = g->value;
        *(g->kind == PARAMETER ? &parameters : &inputs) = 1;
    }
    if (parameters)
        status = ph_set_parameters(s->in, s->p);
    if (inputs && !status)
        status = ph_set_input(s->in, s->u);
    if (!stretch->inside && !status) /* as a run does, whose next step begins from there */
        status = ph_refresh(s->in);
    if (parameters && !status)
        count_stored(s);
    return status;
}

static int consistent(const ph_runs *s) {
    const double *found = ph_signals(s->in) + s->check;
    for (int i = 0; i < s->ncheck; i++)
        if (!(fabs(found[i]) <= s->tolerance[i]))
            return 0;
    return 1;
}

/* A stretch begins: what it changes, and with the first one the run. */
static int enter(const ph_runs *s, int i) {
    int status = change(s, &s->stretches[i]);
    if (i == 0 && !status) {
        status = ph_refresh(s->in); /* for H */
        if (!status && !consistent(s))
            status = PH_RUNS_INCONSISTENT;
        if (!status) {
            count_stored(s);
            begin(s, ph_signals(s->in), s->t0);
        }
    }
    return status;
}

/* A step of a run that is not taken with others. */
static int step(const ph_runs *s, double t, double h) {
    int status = *(const volatile int *)s->stop ? PH_RUNS_STOPPED : 0;
    if (!status)
        status = ph_step(s->in, t, h);
    if (!status && s->refresh)
        status = ph_refresh(s->in);
    return status;
}

/* What a run with lanes looks at after a step: energies are at hand otherwise. */
static void show(const ph_runs *s, const ph_lanes *lanes, int l) {
    ph_lanes_show_ledger(lanes, l);
    for (int i = 0; i < s->nmeasure; i++)
        if (s->measures[i].first < s->energy)
            ph_lanes_show(lanes, l, s->measures[i].first, s->measures[i].count);
}

/* Steps of a stretch of all runs whose status is zero. */
static void march(const ph_runs *const *s, int many, ph_lanes *lanes, int i, double *facts, int *status) {
    const ph_runs_stretch *r = &s[0]->stretches[i];
    for (int n = r->first; n < r->first + r->n; n++) {
        const double t = r->t + (double)n * r->h, end = r->t + (double)(n + 1) * r->h;
        const unsigned taken = lanes && !*(const volatile int *)s[0]->stop ? ph_lanes_step(lanes, t, r->h) : 0;
        for (int l = 0; l < many; l++) {
            if (status[l])
                continue;
            if (taken >> l & 1) {
                show(s[l], lanes, l);
            } else {
                status[l] = step(s[l], t, r->h);
                if (status[l])
                    continue;
                if (lanes)
                    ph_lanes_enter(lanes, l, s[l]->in);
            }
            book(s[l]);
            facts[2 * l] += 1.0;
            add(s[l], ph_signals(s[l]->in), end, r->h);
        }
    }
}

/* Runs side by side, which have the same stretches. */
static void together(const ph_runs *const *s, int many, ph_lanes *lanes, const double *rows, int width,
                     double *out, double *facts, int *status) {
    for (int l = 0; l < many; l++) {
        status[l] = start(s[l], rows + (ptrdiff_t)l * width);
        open_accounts(s[l]);
        facts[2 * l] = facts[2 * l + 1] = 0.0;
    }
    for (int i = 0; i < s[0]->nstretch; i++) {
        if (lanes)
            ph_lanes_leave(lanes);
        for (int l = 0; l < many; l++)
            if (!status[l])
                status[l] = enter(s[l], i);
        march(s, many, lanes, i, facts, status);
    }
    if (lanes)
        ph_lanes_leave(lanes);
    for (int l = 0; l < many; l++)
        if (!status[l]) {
            facts[2 * l + 1] = ph_worst_share(s[l]->accounts);
            tell(s[l], s[l]->length, out + (ptrdiff_t)l * s[l]->nmeasure);
        }
}

int ph_runs_take(const ph_runs *const *s, int many, void *lanes, const double *rows, int width,
                 const double *constants, int n, double *out, double *facts, int *status) {
    int done = 0, failed = 0;
    while (done < n && !failed) {
        const int all = many < n - done ? many : n - done;
        const ptrdiff_t i = done;
        for (int l = 0; l < all; l++)
            memcpy(s[l]->constant, constants + (i + l) * s[l]->ncomp, sizeof(double) * (size_t)s[l]->ncomp);
        together(s, all, lanes, rows + i * width, width, out + i * s[0]->nmeasure, facts + 2 * i, status + i);
        for (int l = 0; l < all; l++)
            failed |= status[i + l];
        done += all;
    }
    return done;
}
