/* Many steps that keep a tolerance in one call, recorded as those of ph_run are. Each trial is taken twice
 * from the same state, by the instance and by a companion under another scheme. */
#include "march.h"

#include <math.h>
#include <string.h>

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
    const double *x = ph_signals(m->in), *other = ph_signals(m->companion);
    double most = 0.0;
    m->worst = 0;
    for (int i = 0; i < m->nx && !isnan(most); i++) {
        const double size = fmax(fabs(m->before[i]), fabs(x[i]));
        const double ratio = fabs(x[i] - other[i]) / (m->rtol * size + m->atol * m->nominal[i]);
        if (!(ratio <= most)) {
            most = ratio;
            m->worst = i;
        }
    }
    return most;
}

/* A step of both from the same state; iterations of steps that were not refused add up. */
static int trial(ph_march *m, const ph_record *record, double h) {
    const long long *own = ph_counts(m->in), *other = ph_counts(m->companion);
    const long long began = own[PH_ITERATIONS], begun = other[PH_ITERATIONS];
    int done, status = ph_continue(m->companion, m->in);
    m->estimator = 1;
    if (status == PH_OK)
        status = m->exactly ? ph_step_exactly(m->companion, m->t, h, 1) : ph_step(m->companion, m->t, h);
    if (status)
        return status;
    m->spent += (double)(other[PH_ITERATIONS] - begun);
    m->estimator = 0;
    status = m->exactly ? ph_step_exactly(m->in, m->t, h, 1) : ph_run(m->in, m->t, h, 1, record, &done);
    if (status == PH_OK) /* a record counts those of the step alone, not those of its end values */
        m->spent += record->counts.data ? record->counts.data[0] : (double)(own[PH_ITERATIONS] - began);
    return status;
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
    m->smallest = fmin(m->smallest, h);
    m->largest = fmax(m->largest, h);
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

/* One step: shorter ones until the tolerance is met; where it ends. */
static int accepted(ph_march *m, const ph_record *record, double goal, double *end) {
    double limit = PH_GROW;
    m->spent = 0.0;
    ph_save(m->in, m->state);
    if (m->nx > 0)
        memcpy(m->before, ph_signals(m->in), sizeof(double) * (size_t)m->nx);
    for (;;) {
        double factor = PH_SHRINK;
        int status;
        m->size = fitted(m, goal, end);
        status = trial(m, record, m->size);
        if (status == PH_OK) {
            m->error = estimate(m);
            if (m->error <= 1.0) {
                grow(m, m->size, m->error, limit);
                return PH_OK;
            }
            factor = fmax(PH_SHRINK, PH_SAFETY * pow(m->error, -1.0 / m->order));
            limit = 1.0;
            status = PH_MISSED;
        }
        ph_load(m->in, m->state);
        if (!shrink(m, m->size, factor))
            return status;
    }
}

/* The columns of a record one row further. */
static void next_row(ph_record *r) {
    ph_column *columns[] = {&r->signals,  &r->x,          &r->a,        &r->y_step,    &r->pairs,
                            &r->stored,   &r->dissipated, &r->supplied, &r->numerical, &r->moved,
                            &r->unknowns, &r->energy,     &r->counts};
    for (size_t i = 0; i < sizeof(columns) / sizeof(columns[0]); i++)
        if (columns[i]->data)
            columns[i]->data += columns[i]->stride;
}

int ph_march_steps(ph_march *m, const ph_record *record, double goal, int room, int *done) {
    ph_record row = {.parts = 1};
    if (record)
        row = *record;
    for (*done = 0; *done < room && m->t < goal; ++*done) {
        double end;
        const int status = accepted(m, &row, goal, &end);
        if (status)
            return status;
        if (row.counts.data)
            row.counts.data[0] = m->spent;
        m->ends[*done] = m->t = end;
        next_row(&row);
    }
    return PH_OK;
}
