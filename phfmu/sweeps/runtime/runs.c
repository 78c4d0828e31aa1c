/* Many runs of one model in compiled code: starts, steps and what is measured of each.
 *
 * Only what is measured is worked out: values of the present time are solved for if asked. The Python side
 * reads the field lists from here: one field a line.
 */
#include "runs.h"

#include "side_by_side.h"

#include <math.h>
#include <string.h>

enum { FIRST, LAST, MIN, MAX, PEAK, MEAN, RMS, TMIN, TMAX };
enum { PARAMETER, STATE, INPUT };

/* Stored energies are the last of the signals; what their changes add up to is at hand, the signals take a
 * solve. */
static double sum(const ph_runs *s, const double *signals, const ph_runs_measure *m) {
    const double *values = m->first < s->energy ? signals + m->first : s->books->now + (m->first - s->energy);
    double total = 0.0;
    for (int i = 0; i < m->count; i++)
        total += values[i];
    return total;
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

/* Runs side by side, which have the same stretches; each with what it works on. lanes: NULL if there is one.
 */
typedef struct {
    const ph_runs *const *each;
    int many;
    ph_lanes *lanes;
} ph_runs_group;

static void open_books(const ph_runs_group *g) {
    const ph_runs *s = g->each[0];
    double *row[PH_NROW];
    if (g->lanes) {
        ph_wide_books_open(g->lanes->books, g->lanes->row);
        return;
    }
    for (int i = 0; i < PH_NROW; i++)
        row[i] = (double *)(uintptr_t)ph_ledger(s->in, i);
    ph_books_open(s->books, row);
}

/* Stored energy of run l from the signals: at the start, and where parameters changed it. */
static void count_stored(const ph_runs_group *g, int l) {
    const ph_runs *s = g->each[l];
    const double *energy = ph_signals(s->in) + s->energy;
    ph_books_stored(s->books, 0, energy);
    if (g->lanes)
        ph_wide_books_stored(g->lanes->books, l, energy);
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

static int change(const ph_runs_group *g, int l, const ph_runs_stretch *stretch) {
    const ph_runs *s = g->each[l];
    int status = 0, parameters = 0, inputs = 0;
    for (int i = stretch->change; i < stretch->until; i++) {
        const ph_runs_change *c = &s->changes[i];
        (c->kind == PARAMETER ? s->p : s->u)[c->index] = c->value;
        *(c->kind == PARAMETER ? &parameters : &inputs) = 1;
    }
    if (parameters)
        status = ph_set_parameters(s->in, s->p);
    if (inputs && !status)
        status = ph_set_input(s->in, s->u);
    if (!stretch->inside && !status) /* as a run does, whose next step begins from there */
        status = ph_refresh(s->in);
    if (parameters && !status)
        count_stored(g, l);
    return status;
}

static int consistent(const ph_runs *s) {
    const double *found = ph_signals(s->in) + s->check;
    for (int i = 0; i < s->ncheck; i++)
        if (!(fabs(found[i]) <= s->tolerance[i]))
            return 0;
    return 1;
}

/* A stretch of run l begins: what it changes, and with the first one the run. */
static int enter(const ph_runs_group *g, int l, int i) {
    const ph_runs *s = g->each[l];
    int status = change(g, l, &s->stretches[i]);
    if (i == 0 && !status) {
        status = ph_refresh(s->in); /* for H */
        if (!status && !consistent(s))
            status = PH_RUNS_INCONSISTENT;
        if (!status) {
            count_stored(g, l);
            begin(s, ph_signals(s->in), s->t0);
        }
    }
    return status;
}

/* A step of a run by itself. */
static int step(const ph_runs *s, double t, double h) {
    int status = *(const volatile int *)s->stop ? PH_RUNS_STOPPED : 0;
    if (!status)
        status = ph_step(s->in, t, h);
    if (!status && s->refresh)
        status = ph_refresh(s->in);
    return status;
}

/* One step of the runs whose status is zero, and into the books with it; those that took it inside the lanes.
 */
static unsigned step_all(const ph_runs_group *g, double t, double h, int *status) {
    ph_lanes *lanes = g->lanes;
    const int stopped = *(const volatile int *)g->each[0]->stop;
    const unsigned inside = lanes && !stopped ? ph_lanes_step(lanes, t, h) : 0;
    for (int l = 0; l < g->many; l++) {
        if (status[l] || inside >> l & 1)
            continue;
        status[l] = step(g->each[l], t, h);
        if (lanes && !status[l])
            ph_lanes_enter(lanes, l, g->each[l]->in);
    }
    if (lanes)
        ph_wide_books_step(lanes->books);
    else if (!status[0])
        ph_books_step(g->each[0]->books);
    return inside;
}

/* Copies the measured values of run l out of the lanes; energies are those that are booked. */
static void show(const ph_runs_group *g, int l, unsigned inside) {
    const ph_runs *s = g->each[l];
    for (int i = 0; i < s->nmeasure; i++) {
        const ph_runs_measure *m = &s->measures[i];
        if (m->first >= s->energy)
            ph_lanes_show_energy(g->lanes, l, s->books->now);
        else if (inside >> l & 1)
            ph_lanes_show(g->lanes, l, m->first, m->count);
    }
}

static void march(const ph_runs_group *g, int i, double *facts, int *status) {
    const ph_runs_stretch *r = &g->each[0]->stretches[i];
    for (int n = r->first; n < r->first + r->n; n++) {
        const double end = r->t + (double)(n + 1) * r->h;
        const unsigned inside = step_all(g, r->t + (double)n * r->h, r->h, status);
        int going = 0;
        for (int l = 0; l < g->many; l++) {
            if (status[l])
                continue;
            if (g->lanes)
                show(g, l, inside);
            facts[2 * l] += 1.0;
            add(g->each[l], ph_signals(g->each[l]->in), end, r->h);
            going = 1;
        }
        if (!going)
            return;
    }
}

static void take(const ph_runs_group *g, const double *rows, int width, double *out, double *facts,
                 int *status) {
    double share[PH_LANE_WIDTH];
    open_books(g);
    for (int l = 0; l < g->many; l++) {
        status[l] = start(g->each[l], rows + (ptrdiff_t)l * width);
        facts[2 * l] = facts[2 * l + 1] = 0.0;
    }
    for (int i = 0; i < g->each[0]->nstretch; i++) {
        if (g->lanes)
            ph_lanes_leave(g->lanes);
        for (int l = 0; l < g->many; l++)
            if (!status[l])
                status[l] = enter(g, l, i);
        march(g, i, facts, status);
    }
    if (g->lanes) {
        ph_lanes_leave(g->lanes);
        ph_wide_books_shares(g->lanes->books, share);
    } else {
        ph_books_shares(g->each[0]->books, share);
    }
    for (int l = 0; l < g->many; l++)
        if (!status[l]) {
            const ph_runs *s = g->each[l];
            facts[2 * l + 1] = share[l];
            tell(s, s->length, out + (ptrdiff_t)l * s->nmeasure);
        }
}

int ph_runs_take(const ph_runs *const *s, int many, void *lanes, const double *rows, int width,
                 const double *constants, int n, double *out, double *facts, int *status) {
    int done = 0, failed = 0;
    while (done < n && !failed) {
        const ptrdiff_t i = done;
        const ph_runs_group g = {s, many < n - done ? many : n - done, lanes};
        for (int l = 0; l < g.many; l++) {
            const double *constant = constants + (i + l) * s[l]->ncomp;
            if (g.lanes)
                ph_wide_books_constant(g.lanes->books, l, constant);
            else
                ph_books_constant(s[l]->books, 0, constant);
        }
        take(&g, rows + i * width, width, out + i * s[0]->nmeasure, facts + 2 * i, status + i);
        for (int l = 0; l < g.many; l++)
            failed |= status[i + l];
        done += g.many;
    }
    return done;
}
