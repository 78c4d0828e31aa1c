/* Jumps of the states along L, with the constraints that hold through them; the twin of
 * engine/event_jump.py.
 */
#include <math.h>
#include <string.h>

#include "event_landing.h"

int ph_refuse_event(ph_landing *l, int reason, double value, double limit) {
    l->refusal = (ph_event_refusal){reason, l->t, value, limit, l->fired};
    return PH_EVENT;
}

/* c and S of the n columns in l->which, at l->x and l->p; the columns of L stay in l->jump. */
static void columns(ph_landing *l, int n) {
    static const double hp[3] = {1.0, 1.0, 1.0};
    const ph_events *e = l->events;
    const int all = e->ncolumn, first = all * e->ncomponent + all * e->nmoved;
    const ph_point at = {l->x, l->y, l->p, hp, l->in->step.work};
    ph_clear(l->jump, first + all * all + e->njump);
    ph_value_of(l->in->model->code, e->jump, &at, l->jump);
    for (int j = 0; j < n; j++) {
        for (int c = 0; c < e->ncomponent; c++)
            l->c[c * n + j] = l->jump[c * all + l->which[j]];
        for (int i = 0; i < n; i++)
            l->s[j * n + i] = l->jump[first + l->which[j] * all + l->which[i]];
    }
}

/* Sign of pivot j: -1 of the velocity of a direction without mass, whose diagonal is 0. */
static double sign(const double *s, int n, int j) {
    return s[j * n + j] == 0.0 ? -1.0 : 1.0;
}

/* Column j of F, s = F D F^T with the signs D; its pivot is 0 where it does not act or depends on those
 * before. */
static void factorise(const double *s, const signed char *acts, int n, int j, double *factor) {
    double pivot = s[j * n + j], size = pivot;
    for (int k = 0; k < j; k++) {
        const double square = factor[j * n + k] * factor[j * n + k];
        pivot -= sign(s, n, k) * square;
        if (s[j * n + j] == 0.0 && s[k * n + k] != 0.0)
            size += square;
    }
    pivot *= sign(s, n, j);
    factor[j * n + j] = acts[j] && pivot > PH_JUMP_DEPENDENT * size ? sqrt(pivot) : 0.0;
    for (int i = j + 1; i < n; i++) {
        double value = s[i * n + j];
        for (int k = 0; k < j; k++)
            value -= sign(s, n, k) * factor[i * n + k] * factor[j * n + k];
        factor[i * n + j] = factor[j * n + j] > 0.0 ? sign(s, n, j) * value / factor[j * n + j] : 0.0;
    }
}

/* l->found (n) with S m = goal for the columns that act by Cholesky's method; 0: one of the first `strict`
 * depends on those before it. Later ones that do (redundant constraints, nodes that nothing is joined to) get
 * m = 0, as those that do not act. */
static int solve(ph_landing *l, int n, int strict) {
    const double *s = l->s, *goal = l->goal;
    double *factor = l->factor, *m = l->found;
    for (int j = 0; j < n; j++) {
        const double *own = factor + j * n;
        factorise(s, l->acts, n, j, factor);
        m[j] = 0.0;
        if (own[j] > 0.0) {
            m[j] = goal[j];
            for (int k = 0; k < j; k++)
                m[j] -= own[k] * m[k];
            m[j] /= own[j];
        } else if (l->acts[j] && j < strict)
            return 0;
    }
    for (int j = n - 1; j >= 0; j--)
        if (factor[j * n + j] > 0.0) {
            m[j] *= sign(s, n, j);
            for (int k = j + 1; k < n; k++)
                m[j] -= factor[k * n + j] * m[k];
            m[j] /= factor[j * n + j];
        }
    return 1;
}

/* The first jump that pushes only whose impulse, or whose c beyond its goal, is negative; -1: none is. */
static int pulls(const ph_landing *l, int n, int jumping) {
    for (int j = 0; j < jumping; j++) {
        double left = -l->goal[j], size = fabs(left);
        if (!l->events->jump_pushes[l->which[j]])
            continue;
        for (int i = 0; i < n; i++) {
            const double part = l->s[j * n + i] * l->found[i];
            left += part;
            size += fabs(part);
        }
        if ((l->acts[j] ? l->s[j * n + j] * l->found[j] : left) < -PH_PUSH_ROUNDING * size)
            return j;
    }
    return -1;
}

/* 0 <= m, 0 <= S m - goal, one of them zero, for jumps that push only: the first that is wrong changes sides
 * until none is, which ends for S positive definite; the twin of `pushing` in events/impulse.py. */
static int choose(ph_landing *l, int n, int jumping) {
    memset(l->acts, 1, (size_t)n);
    for (int tries = 0; tries < PH_MOST_PUSHING && solve(l, n, jumping); tries++) {
        const int wrong = pulls(l, n, jumping);
        if (wrong < 0)
            return 1;
        l->acts[wrong] = !l->acts[wrong];
    }
    return 0;
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

/* Refuse the events that happen and jump: their columns depend on each other. */
static int refuse_jumping(ph_landing *l) {
    for (int i = 0; i < l->events->n; i++)
        l->fired[i] = l->fired[i] && l->events->jump_of[i] >= 0;
    return ph_refuse_event(l, PH_REFUSED_DEPENDENT, 0.0, 0.0);
}

/* The values that impulses are to turn c into, for n columns of which the first `jumping` jump. */
static int aim(ph_landing *l, int n, int jumping) {
    const ph_events *e = l->events;
    const double *restitution = l->jump + e->ncolumn * (e->ncomponent + e->nmoved + e->ncolumn);
    for (int j = 0; j < n; j++) {
        const double c = sum_c(l, l->c, n, j);
        l->e[j] = j < jumping && !l->rests[l->whose[j]] ? restitution[l->which[j]] : 0.0;
        l->goal[j] = -(1.0 + l->e[j]) * c;
        l->m[j] = 0.0;
        if (j < jumping && fabs(c) > e->jump_most[l->which[j]])
            return refuse_one(l, l->whose[j], fabs(c), e->jump_most[l->which[j]]);
    }
    return PH_OK;
}

/* x += L m, c(x) = -e c before where it acts; twice, which corrects the rounding of the first. */
static int move(ph_landing *l, int n, int jumping) {
    const ph_events *e = l->events;
    int status;
    columns(l, n);
    memcpy(l->before_c, l->c, sizeof(double) * (size_t)(n * e->ncomponent));
    status = aim(l, n, jumping);
    for (int pass = 0; pass < 2 && status == PH_OK; pass++) {
        if (!(pass ? solve(l, n, jumping) : choose(l, n, jumping)))
            return refuse_jumping(l);
        for (int j = 0; j < n; j++) {
            const double *column = l->jump + e->ncolumn * e->ncomponent + l->which[j] * e->nmoved;
            l->m[j] += l->found[j];
            for (int i = 0; i < e->nmoved; i++)
                l->x[e->jump_moved[i]] += column[i] * l->found[j];
        }
        columns(l, n);
        for (int j = 0; j < n; j++)
            l->goal[j] = -l->e[j] * sum_c(l, l->before_c, n, j) - sum_c(l, l->c, n, j);
    }
    return status;
}

int ph_jump_event(ph_landing *l, double *energy, double *lost) {
    ph_instance *in = l->in;
    const ph_events *e = l->events;
    double total = 0.0, moved = 0.0;
    int n = 0, jumping, first = -1, status;
    for (int i = 0; i < e->n && e->ncolumn; i++) {
        if (!l->fired[i])
            continue;
        first = first < 0 ? i : first;
        if (e->jump_of[i] >= 0) {
            l->which[n] = e->jump_of[i];
            l->whose[n++] = i;
        }
    }
    jumping = n;
    for (int j = e->njump; j < e->ncolumn; j++)
        l->which[n++] = j;
    if (n == 0)
        return PH_OK;
    memcpy(l->x, in->table, sizeof(double) * (size_t)in->model->step->nx);
    l->x[in->model->step->nx] = l->t;
    status = move(l, n, jumping);
    if (status)
        return status;
    for (int j = 0; j < n; j++) {
        double loss = 0.0;
        for (int c = 0; c < e->ncomponent; c++) {
            const double before = l->before_c[c * n + j], after = l->c[c * n + j];
            const double work = l->m[j] * (before + after) / 2;
            energy[e->jump_component[c]] += work;
            loss -= work;
            moved += fabs(l->m[j]) * (fabs(before) + fabs(after)) / 2;
        }
        lost[e->owner[j < jumping ? l->whose[j] : first]] += loss;
        total += loss;
    }
    if (-total > PH_LOSS_ROUNDING * moved)
        return ph_refuse_event(l, PH_REFUSED_GAIN, -total, 0.0);
    return ph_set_x(in, l->t, l->x);
}
