/* Many steps that keep a tolerance in one call, recorded as those of ph_run are. Each span is taken twice
 * from the same state: by the instance and by a companion, under another scheme or in one step instead of
 * two. With guards a span is sized as without them, and its steps end on their zeros too. */
#include "march.h"

#include <math.h>
#include <string.h>

/* The instance that steps now; NULL if its mode cannot be had. */
static ph_instance *own(const ph_march *m) {
    const ph_mode *present = m->modes ? ph_modes_present(m->modes) : NULL;
    return m->modes ? (present ? present->in : NULL) : m->in;
}

static int guarded(const ph_march *m) {
    return m->landing || m->modes;
}

static double rounded(double h) {
    int exponent;
    const double mantissa = frexp(h, &exponent);
    return ldexp(floor(ldexp(mantissa, PH_DIGITS)), exponent - PH_DIGITS);
}

/* The proposed size, or what is left up to the goal; half of that if less than two steps are. */
static double fitted(const ph_march *m, double goal, double *end) {
    const double left = goal - m->t;
    double h = m->h;
    if (h >= left * (1 - PH_NEAR)) {
        *end = goal;
        return left;
    }
    if (2 * h > left)
        h = rounded(left / 2);
    *end = m->t + h;
    return h;
}

/* Largest difference of the two solutions relative to its tolerance, and the state it belongs to; not a
 * number if any is none. */
static double estimate(ph_march *m) {
    const double *x = ph_signals(own(m)), *other = ph_signals(m->companion);
    double most = 0.0;
    m->worst = 0;
    for (int i = 0; i < m->nx && !isnan(most); i++) {
        const double size = fmax(fabs(m->before[i]), fabs(x[i]));
        const double ratio = m->share * fabs(x[i] - other[i]) / (m->rtol * size + m->atol * m->nominal[i]);
        if (!(ratio <= most)) {
            most = ratio;
            m->worst = i;
        }
    }
    return most;
}

/* The companion goes on from the instance, in its mode. */
static int follow(ph_march *m, const ph_instance *in) {
    if (m->others) {
        const int same = memcmp(m->beside, m->sides, (size_t)m->nside) == 0;
        const ph_mode *mode;
        memcpy(m->beside, m->sides, (size_t)m->nside);
        mode = ph_modes_present(m->others);
        if (!mode)
            return PH_EVENT;
        m->companion = mode->in;
        if (!same)
            ph_load(mode->in, mode->fresh);
    }
    return ph_continue(m->companion, in);
}

/* The span by the companion; iterations of steps that were not refused add up. */
static int companion_step(ph_march *m, const ph_instance *in, double h) {
    long long began;
    int status = follow(m, in);
    m->estimator = 1;
    if (status)
        return status;
    began = ph_counts(m->companion)[PH_ITERATIONS];
    status = guarded(m) ? ph_step_exactly(m->companion, m->t, h, 1) : ph_step(m->companion, m->t, h);
    if (status)
        return status;
    m->spent += (double)(ph_counts(m->companion)[PH_ITERATIONS] - began);
    m->estimator = 0;
    return PH_OK;
}

static void keep(ph_march *m, const ph_instance *in) {
    ph_save(in, m->state);
    if (m->modes)
        memcpy(m->kept, m->sides, (size_t)m->nside);
    if (m->nx > 0)
        memcpy(m->before, ph_signals(in), sizeof(double) * (size_t)m->nx);
}

static void back(ph_march *m) {
    ph_instance *in;
    if (m->modes)
        memcpy(m->sides, m->kept, (size_t)m->nside);
    in = own(m);
    if (in)
        ph_load(in, m->state);
}

/* The next proposal by the PI controller; a step cut short by the goal does not lower it. */
static void grow(ph_march *m, double h, double found, double limit) {
    const double error = fmax(found, PH_LEAST_ERROR);
    const double factor =
        PH_SAFETY * pow(error, -PH_INTEGRAL / m->order) * pow(m->last, PH_PROPORTIONAL / m->order);
    const double proposal = h * fmin(limit, fmax(PH_SHRINK, factor));
    const double cut = h < m->h && limit > 1.0 ? m->h : 0.0;
    m->h = rounded(fmin(fmax(fmax(proposal, cut), m->min_step), m->max_step));
    m->last = error;
    m->smallest = fmin(m->smallest, h / m->parts);
    m->largest = fmax(m->largest, h / m->parts);
}

/* A smaller proposal; 0 if the step is as small as it may be. */
static int shrink(ph_march *m, double h, double factor) {
    const double least = fmax(m->min_step, fmax(PH_LOST * fabs(m->t), PH_TINY));
    if (h <= least * (1 + PH_NEAR))
        return 0;
    m->rejected++;
    m->h = rounded(fmax(factor * h, m->min_step));
    return 1;
}

/* The columns of a record n rows further. */
static void further(ph_record *r, int n) {
    ph_column *columns[] = {&r->signals,  &r->x,          &r->a,        &r->y_step,    &r->pairs,
                            &r->stored,   &r->dissipated, &r->supplied, &r->numerical, &r->moved,
                            &r->unknowns, &r->energy,     &r->counts};
    for (size_t i = 0; i < sizeof(columns) / sizeof(columns[0]); i++)
        if (columns[i]->data)
            columns[i]->data += n * columns[i]->stride;
}

/* What steps are written to: rows without guards, and rows and events with them. */
typedef struct ph_place {
    ph_record record;
    ph_landed *landed; /* NULL without guards */
    signed char *changed;
} ph_place;

/* Iterations of n rows. */
static double iterations(const ph_record *r, int n) {
    double sum = 0.0;
    for (int i = 0; i < n && r->counts.data; i++)
        sum += r->counts.data[i * r->counts.stride];
    return sum;
}

static int land_on(ph_march *m, const ph_place *at) {
    return m->modes ? ph_modes_land(m->modes, &at->record, at->landed, at->changed)
                    : ph_land(m->landing, &at->record, at->landed);
}

/* The span with what happens in it, up to the first event unless it is to be landed whole. */
static int land(ph_march *m, const ph_place *at, double h) {
    at->landed->pause = m->crowd < PH_CROWD;
    if (m->modes)
        ph_modes_from(m->modes, m->t, h / m->parts, 0, m->parts, 0);
    else
        ph_land_from(m->landing, m->t, h / m->parts, 0, m->parts, 0);
    return land_on(m, at);
}

/* The span without a look at guards, not recorded. */
static int step_blindly(ph_march *m, double h) {
    ph_instance *in = own(m);
    const long long began = in ? ph_counts(in)[PH_ITERATIONS] : 0;
    const int status = in ? ph_step_exactly(in, m->t, h, m->parts) : PH_EVENT;
    if (status == PH_OK)
        m->spent += (double)(ph_counts(in)[PH_ITERATIONS] - began);
    return status;
}

/* A trial of the span; *events: something happens in it, or cannot, and nothing is recorded yet. */
static int trial(ph_march *m, const ph_place *at, double h, int *events) {
    int done, status = companion_step(m, own(m), h);
    *events = 0;
    if (status)
        return status;
    if (!at->landed) {
        ph_instance *in = m->in;
        const long long began = ph_counts(in)[PH_ITERATIONS];
        status = ph_run(in, m->t, h / m->parts, m->parts, &at->record, &done);
        if (status == PH_OK) /* a record counts those of the steps alone, not those of their end values */
            m->spent += at->record.counts.data ? iterations(&at->record, m->parts)
                                               : (double)(ph_counts(in)[PH_ITERATIONS] - began);
        return status;
    }
    status = land(m, at, h);
    *events = status || at->landed->events || !at->landed->done;
    if (!*events) {
        m->spent += iterations(&at->record, at->landed->steps);
        return PH_OK;
    }
    back(m);
    return step_blindly(m, h);
}

/* After a landing: whether there was no room for all of it, and where it ends if not at *end. */
static void reached(ph_march *m, const ph_landed *found, double *end) {
    const int first = found->pause && found->events > 0;
    m->unfinished = found->done || first ? 0 : found->pause ? 2 : 1;
    m->end = *end;
    if (first && found->event_t[0] < *end) {
        *end = found->event_t[0];
        m->last = 1.0;
        m->crowd++;
    } else {
        m->crowd = 0;
    }
}

/* The accepted span again, with the events in it; *end: where it ends. */
static int land_events(ph_march *m, const ph_place *at, double *end) {
    int status;
    back(m);
    status = land(m, at, m->size);
    if (at->record.counts.data && at->landed->steps > 0)
        at->record.counts.data[0] += m->spent;
    if (status == PH_OK)
        reached(m, at->landed, end);
    return status;
}

/* One span: shorter ones until the tolerance is met; where it ends. */
static int accepted(ph_march *m, const ph_place *at, double goal, double *end) {
    double limit = PH_GROW;
    ph_instance *in = own(m);
    m->spent = 0.0;
    if (!in || ph_state_size(in) > sizeof(double) * (size_t)m->room)
        return in ? PH_SMALL : PH_EVENT;
    keep(m, in);
    for (;;) {
        double factor = PH_SHRINK;
        int status, events;
        m->size = fitted(m, goal, end);
        status = trial(m, at, m->size, &events);
        if (status == PH_OK) {
            m->error = estimate(m);
            if (m->error <= 1.0) {
                grow(m, m->size, m->error, limit);
                if (events)
                    return land_events(m, at, end);
                if (at->record.counts.data)
                    at->record.counts.data[0] +=
                        m->spent - iterations(&at->record, at->landed ? at->landed->steps : m->parts);
                m->crowd = 0;
                return PH_OK;
            }
            factor = fmax(PH_SHRINK, PH_SAFETY * pow(m->error, -1.0 / m->order));
            limit = 1.0;
            status = PH_MISSED;
        }
        back(m);
        if (!shrink(m, m->size, factor)) {
            if (at->landed) /* of the trial */
                at->landed->steps = at->landed->events = 0;
            return status;
        }
    }
}

/* The first goal that is not reached yet, from *at on; 0: there is none. */
static int next_goal(const ph_march *m, const ph_goals *goals, int *at, double *goal) {
    while (*at < goals->n && m->t >= goals->t[*at])
        ++*at;
    *goal = *at < goals->n ? goals->t[*at] : m->t;
    return *at < goals->n;
}

int ph_march_steps(ph_march *m, const ph_record *record, const ph_goals *goals, int room, int *done) {
    ph_place at = {*record, NULL, NULL};
    double goal, end;
    int passed = 0;
    for (*done = 0; *done + m->parts <= room && next_goal(m, goals, &passed, &goal); *done += m->parts) {
        const int status = accepted(m, &at, goal, &end);
        if (status)
            return status;
        for (int i = 1; i < m->parts; i++)
            m->ends[*done + i - 1] = m->t + i * (m->size / m->parts);
        m->ends[*done + m->parts - 1] = m->t = end;
        further(&at.record, m->parts);
    }
    return PH_OK;
}

/* Room for rows and events behind those in `out`. */
static ph_landed behind(const ph_march *m, const ph_landed *out) {
    ph_landed rest = *out;
    const ptrdiff_t n = out->events;
    rest.steps_room -= out->steps;
    rest.events_room -= out->events;
    rest.t += out->steps;
    rest.h += out->steps;
    rest.event_t += n;
    rest.event_step += n;
    rest.event_fired += n * m->nguard;
    rest.event_energy += n * m->ncomp;
    rest.event_lost += n * m->ncomp;
    rest.event_signals += n * m->nsignal;
    return rest;
}

/* What was written there belongs to `out`. */
static void add(ph_landed *out, const ph_landed *rest) {
    for (int i = 0; i < rest->events; i++)
        rest->event_step[i] += out->steps;
    out->steps += rest->steps;
    out->events += rest->events;
}

int ph_march_landed(ph_march *m, const ph_record *record, const ph_goals *goals, ph_landed *out,
                    signed char *changed) {
    const int nswitch = (m->nside - 1) / 2;
    int status = PH_OK, passed = 0;
    double goal;
    out->steps = out->events = 0;
    while (status == PH_OK && next_goal(m, goals, &passed, &goal)) {
        ph_landed rest = behind(m, out);
        ph_place at = {*record, &rest, changed + (ptrdiff_t)out->events * nswitch};
        double end = m->end;
        if (rest.steps_room < PH_ROOM || rest.events_room < PH_ROOM || (m->pauses && out->events))
            break;
        further(&at.record, out->steps);
        rest.steps = rest.events = rest.done = 0;
        if (m->unfinished) {
            rest.pause = m->unfinished == 2;
            status = land_on(m, &at);
            if (status == PH_OK)
                reached(m, &rest, &end);
        } else {
            status = accepted(m, &at, goal, &end);
        }
        add(out, &rest);
        if (status || m->unfinished)
            break;
        m->t = end;
    }
    return status;
}
