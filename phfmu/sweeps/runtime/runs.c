/* Many runs of one model in compiled code: starts, steps and what is measured of each.
 *
 * The model is a library of its own, called through a table of functions; this is the same for every model
 * and is compiled once. Only what is measured is worked out: values of the present time are solved for if
 * asked. The Python side reads the field lists from here: one field a line.
 */
#include "runs.h"

#include <float.h>
#include <math.h>
#include <string.h>

/* What `owes` judges a step with: those of phfmu/audit/judge.py. */
#define FLOOR 1024.0
#define ULPS 64.0

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
    memcpy(s->now, s->calls->signals(s->in) + s->energy, sizeof(double) * (size_t)s->ncomp);
    memset(s->carry, 0, sizeof(double) * (size_t)s->ncomp);
}

/* Its change over the last step, by a compensated sum. */
static void add_stored(const ph_runs *s, const double *stored) {
    for (int k = 0; k < s->ncomp; k++) {
        double part = stored[k] + s->carry[k], total = s->now[k] + part;
        s->carry[k] = part - (total - s->now[k]);
        s->now[k] = total;
    }
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

/* How much of what is allowed the last step misses, at most over the components; *status of a solve for H. */
static double owes(const ph_runs *s, int *status) {
    const ph_runs_calls *c = s->calls;
    const double *row[6], *pairs;
    double worst = 0.0;
    for (int i = 0; i < 6; i++)
        row[i] = c->ledger(s->in, s->row[i]);
    pairs = row[5];
    for (int k = 0; k < s->ncomp; k++) {
        const double stored = row[0][k], dissipated = row[1][k], supplied = row[2][k], numerical = row[3][k];
        double play = row[4][k] + fabs(dissipated) + fabs(supplied) + fabs(numerical), allowed;
        const double missing = fabs(stored + dissipated + numerical - supplied);
        for (int j = 0; j < s->nq; j++)
            play += s->owner[j] == k ? fabs(pairs[j]) : 0.0;
        s->change[k] += stored;
        s->reach[k] = fmax(s->reach[k], fmax(play, fabs(s->change[k])));
        allowed = s->rtol * play + FLOOR * DBL_EPSILON * s->reach[k];
        if (missing > allowed) { /* what rounding leaves of H counts too: it takes a solve to know H */
            *status = c->refresh(s->in);
            if (*status)
                return worst;
            allowed += ULPS * DBL_EPSILON * fabs(c->signals(s->in)[s->energy + k]);
        }
        if (!(missing <= worst * allowed))
            worst = missing / allowed;
    }
    return worst;
}

static int start(const ph_runs *s, const double *row) {
    const ph_runs_calls *c = s->calls;
    int status = c->reset(s->in);
    memcpy(s->p, s->p0, sizeof(double) * (size_t)s->np);
    memcpy(s->x, s->x0, sizeof(double) * (size_t)s->nx);
    memcpy(s->u, s->u0, sizeof(double) * (size_t)s->nu);
    for (int i = 0; i < s->nplace; i++) {
        const ph_runs_place *q = &s->places[i];
        (q->kind == PARAMETER ? s->p : q->kind == STATE ? s->x : s->u)[q->index] = row[q->column];
    }
    if (!status)
        status = c->set_parameters(s->in, s->p);
    if (!status)
        status = c->set_x(s->in, s->t0, s->x);
    if (!status)
        status = c->set_input(s->in, s->u);
    return status ? status : c->initialise(s->in);
}

static int change(const ph_runs *s, const ph_runs_stretch *stretch) {
    int status = 0, parameters = 0, inputs = 0;
    for (int i = stretch->change; i < stretch->until; i++) {
        const ph_runs_change *g = &s->changes[i];
        (g->kind == PARAMETER ? s->p : s->u)[g->index] = g->value;
        *(g->kind == PARAMETER ? &parameters : &inputs) = 1;
    }
    if (parameters)
        status = s->calls->set_parameters(s->in, s->p);
    if (inputs && !status)
        status = s->calls->set_input(s->in, s->u);
    if (parameters && s->stored && !status) {
        status = s->calls->refresh(s->in);
        if (!status)
            count_stored(s);
    }
    return status;
}

static int consistent(const ph_runs *s) {
    const double *found = s->calls->signals(s->in) + s->check;
    for (int i = 0; i < s->ncheck; i++)
        if (!(fabs(found[i]) <= s->tolerance[i]))
            return 0;
    return 1;
}

static int one(const ph_runs *s, const double *row, double *out, double *facts) {
    const ph_runs_calls *c = s->calls;
    int status = start(s, row);
    memset(s->reach, 0, sizeof(double) * (size_t)s->ncomp);
    memset(s->change, 0, sizeof(double) * (size_t)s->ncomp);
    facts[0] = facts[1] = 0.0;
    for (int i = 0; i < s->nstretch && !status; i++) {
        const ph_runs_stretch *r = &s->stretches[i];
        status = change(s, r);
        if (i == 0 && !status) {
            if (s->refresh || s->stored || s->ncheck)
                status = c->refresh(s->in);
            if (!status && !consistent(s))
                status = PH_RUNS_INCONSISTENT;
            if (!status) {
                count_stored(s);
                begin(s, c->signals(s->in), s->t0);
            }
        }
        for (int n = 0; n < r->n && !status; n++) {
            double missing;
            status = c->step(s->in, r->t + (double)n * r->h, r->h);
            if (!status && s->refresh)
                status = c->refresh(s->in);
            if (status)
                break;
            missing = owes(s, &status);
            add_stored(s, c->ledger(s->in, s->row[0]));
            facts[0] += 1.0;
            facts[1] = missing <= facts[1] ? facts[1] : missing;
            add(s, c->signals(s->in), r->t + (double)(n + 1) * r->h, r->h);
        }
    }
    if (!status)
        tell(s, s->length, out);
    return status;
}

int ph_runs_take(const ph_runs *s, const double *rows, int width, int n, double *out, double *facts,
                 int *done) {
    int status = 0;
    for (*done = 0; *done < n && !status; *done += !status)
        status =
            one(s, rows + (ptrdiff_t)*done * width, out + (ptrdiff_t)*done * s->nmeasure, facts + 2 * *done);
    return status;
}
