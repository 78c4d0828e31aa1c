/* What happens at a zero: the states jump, parameters are set; the twin of the same part of
 * engine/landing.py. */
#include <math.h>
#include <string.h>

#include "event_landing.h"

static void *place(char *base, size_t *used, size_t bytes) {
    const size_t at = *used;
    *used += (bytes + 15) / 16 * 16;
    return base ? base + at : NULL;
}

static double *doubles(char *base, size_t *used, int n) {
    return place(base, used, sizeof(double) * (size_t)n);
}

static size_t lay_out(ph_landing *l, char *base) {
    const ph_events *e = l->events;
    const ph_plan *p = l->in->model->step;
    const int n = e->njump, c = e->ncomponent * n;
    size_t used = 0;
    place(base, &used, sizeof(*l));
    l->last = doubles(base, &used, e->n);
    l->start = doubles(base, &used, e->n);
    l->now = doubles(base, &used, e->n);
    l->values = doubles(base, &used, e->npoint * e->n);
    l->fits = doubles(base, &used, e->npoint * e->n);
    l->x = doubles(base, &used, p->nx + 1);
    l->start_x = doubles(base, &used, p->nx + 1);
    l->w = doubles(base, &used, p->nw);
    l->y = doubles(base, &used, p->na + p->nu);
    l->p = doubles(base, &used, p->np);
    l->jump = doubles(base, &used, n * (e->ncomponent + e->nmoved + n + 1));
    l->c = doubles(base, &used, c);
    l->before_c = doubles(base, &used, c);
    l->s = doubles(base, &used, n * n);
    l->factor = doubles(base, &used, n * n);
    l->goal = doubles(base, &used, n);
    l->m = doubles(base, &used, n);
    l->found = doubles(base, &used, n);
    l->e = doubles(base, &used, n);
    l->which = place(base, &used, sizeof(int) * (size_t)n);
    l->whose = place(base, &used, sizeof(int) * (size_t)n);
    l->fired = place(base, &used, (size_t)e->n);
    l->rests = place(base, &used, (size_t)e->n);
    l->looked = place(base, &used, (size_t)e->n);
    l->from_zero = place(base, &used, (size_t)e->n);
    l->refused = place(base, &used, (size_t)e->n);
    l->before = place(base, &used, ph_state_size(l->in));
    l->after = place(base, &used, ph_state_size(l->in));
    return used;
}

size_t ph_landing_size(const ph_instance *in, const ph_events *events) {
    ph_landing l = {.in = (ph_instance *)in, .events = events};
    return lay_out(&l, NULL);
}

ph_landing *ph_landing_init(void *memory, ph_instance *in, const ph_events *events) {
    ph_landing *l = memory;
    memset(memory, 0, ph_landing_size(in, events));
    l->in = in;
    l->events = events;
    lay_out(l, memory);
    return l;
}

const ph_event_refusal *ph_land_refusal(const ph_landing *l) {
    return &l->refusal;
}

int ph_refuse_event(ph_landing *l, int reason, double value, double limit) {
    l->refusal = (ph_event_refusal){reason, l->t, value, limit, l->fired};
    return PH_EVENT;
}

/* c and S of the n jumps that happen, at l->x; the columns of L stay in l->jump. */
static void columns(ph_landing *l, int n) {
    static const double hp[3] = {1.0, 1.0, 1.0};
    const ph_events *e = l->events;
    const int all = e->njump, first = all * e->ncomponent + all * e->nmoved;
    const ph_point at = {l->x, l->y, l->in->p, hp};
    ph_clear(l->jump, all * (e->ncomponent + e->nmoved + all + 1));
    ph_kernels[e->jump->kernel].value(e->jump, &at, l->jump);
    for (int j = 0; j < n; j++) {
        for (int c = 0; c < e->ncomponent; c++)
            l->c[c * n + j] = l->jump[c * all + l->which[j]];
        for (int i = 0; i < n; i++)
            l->s[j * n + i] = l->jump[first + l->which[j] * all + l->which[i]];
    }
}

/* m (n) = S^-1 goal by Cholesky's method; 0: the columns depend on each other. */
static int solve(const double *s, const double *goal, int n, double *factor, double *m) {
    for (int j = 0; j < n; j++) {
        double pivot = s[j * n + j];
        for (int k = 0; k < j; k++)
            pivot -= factor[j * n + k] * factor[j * n + k];
        if (!(pivot > PH_JUMP_DEPENDENT * s[j * n + j]))
            return 0;
        factor[j * n + j] = sqrt(pivot);
        for (int i = j + 1; i < n; i++) {
            double value = s[i * n + j];
            for (int k = 0; k < j; k++)
                value -= factor[i * n + k] * factor[j * n + k];
            factor[i * n + j] = value / factor[j * n + j];
        }
        m[j] = goal[j];
        for (int k = 0; k < j; k++)
            m[j] -= factor[j * n + k] * m[k];
        m[j] /= factor[j * n + j];
    }
    for (int j = n - 1; j >= 0; j--) {
        for (int k = j + 1; k < n; k++)
            m[j] -= factor[k * n + j] * m[k];
        m[j] /= factor[j * n + j];
    }
    return 1;
}

static double sum_c(const ph_landing *l, const double *c, int n, int j) {
    double sum = 0.0;
    for (int i = 0; i < l->events->ncomponent; i++)
        sum += c[i * n + j];
    return sum;
}

/* One event alone is to blame. */
static int refuse_one(ph_landing *l, int i, double value, double limit) {
    memset(l->fired, 0, (size_t)l->events->n);
    l->fired[i] = 1;
    return ph_refuse_event(l, PH_REFUSED_MOST, value, limit);
}

/* x += L m, c(x) = -e c before, for the n jumps in l->which; twice, which corrects the rounding of the first.
 */
static int move(ph_landing *l, int n) {
    const ph_events *e = l->events;
    const int all = e->njump;
    columns(l, n);
    memcpy(l->before_c, l->c, sizeof(double) * (size_t)(n * e->ncomponent));
    for (int j = 0; j < n; j++) {
        const double c = sum_c(l, l->c, n, j), most = e->jump_most[l->which[j]];
        l->e[j] =
            l->rests[l->whose[j]] ? 0.0 : l->jump[all * (e->ncomponent + e->nmoved + all) + l->which[j]];
        l->goal[j] = -(1.0 + l->e[j]) * c;
        l->m[j] = 0.0;
        if (fabs(c) > most)
            return refuse_one(l, l->whose[j], fabs(c), most);
    }
    for (int pass = 0; pass < 2; pass++) {
        if (!solve(l->s, l->goal, n, l->factor, l->found))
            return ph_refuse_event(l, PH_REFUSED_DEPENDENT, 0.0, 0.0);
        for (int j = 0; j < n; j++) {
            const double *column = l->jump + all * e->ncomponent + l->which[j] * e->nmoved;
            l->m[j] += l->found[j];
            for (int i = 0; i < e->nmoved; i++)
                l->x[e->jump_moved[i]] += column[i] * l->found[j];
        }
        columns(l, n);
        for (int j = 0; j < n; j++)
            l->goal[j] = -l->e[j] * sum_c(l, l->before_c, n, j) - sum_c(l, l->c, n, j);
    }
    return PH_OK;
}

/* The jumps of the events in l->fired, with their energies. */
static int jump(ph_landing *l, double *energy, double *lost) {
    ph_instance *in = l->in;
    const ph_events *e = l->events;
    double total = 0.0, moved = 0.0;
    int n = 0, status;
    for (int i = 0; i < e->n && e->njump; i++)
        if (l->fired[i] && e->jump_of[i] >= 0) {
            l->which[n] = e->jump_of[i];
            l->whose[n++] = i;
        }
    if (n == 0)
        return PH_OK;
    memcpy(l->x, in->table, sizeof(double) * (size_t)in->model->step->nx);
    l->x[in->model->step->nx] = l->t;
    status = move(l, n);
    if (status)
        return status;
    for (int j = 0; j < n; j++) {
        double loss = 0.0;
        for (int c = 0; c < e->ncomponent; c++) {
            const double work = l->m[j] * (l->before_c[c * n + j] + l->c[c * n + j]) / 2;
            energy[e->jump_component[c]] += work;
            loss -= work;
            moved += fabs(work);
        }
        lost[e->jump_owner[l->which[j]]] += loss;
        total += loss;
    }
    if (-total > PH_LOSS_ROUNDING * moved)
        return ph_refuse_event(l, PH_REFUSED_GAIN, -total, 0.0);
    return ph_set_x(in, l->t, l->x);
}

static void set(double *p, const int *ptr, const int *which, const double *value, int i) {
    for (int j = ptr[i]; j < ptr[i + 1]; j++)
        p[which[j]] = value[j];
}

int ph_happen(ph_landing *l, ph_landed *out) {
    ph_instance *in = l->in;
    const ph_events *e = l->events;
    const ph_plan *p = in->model->step;
    const int crowded = l->happened >= PH_MOST_EVENTS, length = in->offset[PH_NBLOCK];
    double *energy = out->event_energy + out->events * p->ncomp,
           *lost = out->event_lost + out->events * p->ncomp;
    int any = 0, status;
    for (int i = 0; i < e->n; i++) {
        const int piled = crowded || l->t - l->last[i] < PH_PILE_UP * l->grid;
        l->rests[i] = l->fired[i] && piled && e->rest_ptr[i + 1] > e->rest_ptr[i];
        any += l->rests[i];
    }
    if (crowded && !any)
        return ph_refuse_event(l, PH_REFUSED_PILE, 0.0, 0.0);
    ph_clear(energy, p->ncomp);
    ph_clear(lost, p->ncomp);
    ph_save(in, l->before); /* where a refused event leaves the instance */
    status = jump(l, energy, lost);
    if (p->np > 0)
        memcpy(l->p, in->p, sizeof(double) * (size_t)p->np);
    for (int i = 0; i < e->n; i++)
        if (l->fired[i])
            set(l->p, e->sets_ptr, e->sets_p, e->sets_value, i);
    for (int i = 0; i < e->n; i++)
        if (l->rests[i])
            set(l->p, e->rest_ptr, e->rest_p, e->rest_value, i);
    status = status ? status : ph_set_parameters(in, l->p);
    status = status ? status : ph_initialise(in);
    if (status) {
        ph_load(in, l->before);
        return status;
    }
    for (int i = 0; i < e->n; i++) {
        out->event_fired[out->events * e->n + i] = (signed char)(l->fired[i] + l->rests[i]);
        if (l->fired[i])
            l->last[i] = l->t;
    }
    memcpy(out->event_signals + out->events * length, in->table, sizeof(double) * (size_t)length);
    out->event_t[out->events] = l->t;
    out->event_step[out->events] = out->steps;
    out->events++;
    return PH_OK;
}
