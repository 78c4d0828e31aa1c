/* Signals that are held over a step; sampled_signals.py has the rule. */
#include "held.h"

#include <string.h>

#include "master.h"
#include "system.h"

static size_t bytes(int n) {
    return sizeof(double) * (size_t)n;
}

/* Inputs of a share as they are where no step is taken: at the ends of polynomials, with ports of signals. */
static int present(const ph_master *m, const ph_share *s) {
    ph_share_inputs(m, s, s->y);
    ph_clear(s->now, s->nu);
    for (int i = 0; i < s->k; i++)
        for (int j = 0; j < s->nu; j++)
            s->now[j] += s->at_end[i] * s->y[i * s->nu + j];
    return s->kind->present(s);
}

/* Wires from..to-1 bring these values. */
static int write(ph_master *m, const double *values, int from, int to) {
    const ph_held *w = m->held;
    int status = PH_OK;
    for (int i = from; i < to; i++) {
        const ph_share *s = &m->shares[w->target[i]];
        if (w->taken[i] < 0)
            s->free[w->input[i]] = values[i];
        else
            s->taken[w->taken[i]] = values[i];
    }
    for (int i = from; i < to && status == PH_OK; i++) {
        const ph_share *s = &m->shares[w->target[i]];
        int last = 1; /* of the same kind into this share */
        for (int j = i + 1; j < to && last; j++)
            last = w->target[j] != w->target[i] || (w->taken[j] < 0) != (w->taken[i] < 0);
        if (last)
            status = ph_share_said(m, w->target[i], w->taken[i] < 0 ? present(m, s) : s->kind->take(s));
    }
    return status;
}

int ph_held_before(ph_master *m, double h) {
    ph_held *w = m->held;
    if (!w)
        return PH_OK;
    w->known_kept = w->known;
    w->last_kept = w->last;
    memcpy(w->now_kept, w->now, bytes(w->n));
    memcpy(w->before_kept, w->before, bytes(w->n));
    if (!w->known || !w->extrapolated)
        return PH_OK;
    for (int i = 0; i < w->n; i++) {
        double value = w->now[i] + h / (2.0 * w->last) * (w->now[i] - w->before[i]);
        const int inside = w->low[i] <= w->now[i] && w->now[i] <= w->high[i];
        if (value < w->low[i])
            value = w->low[i];
        if (value > w->high[i])
            value = w->high[i];
        w->values[i] = inside ? value : w->now[i];
    }
    return write(m, w->values, 0, w->n);
}

int ph_held_sample(ph_master *m) {
    ph_held *w = m->held;
    int status = PH_OK;
    for (int g = 0; w && g < w->nstage && status == PH_OK; g++) {
        int read = -1;
        for (int i = w->stage[g]; i < w->stage[g + 1] && status == PH_OK; i++) {
            const ph_share *s = &m->shares[w->source[i]];
            if (w->source[i] != read)
                status = ph_share_said(m, w->source[i], s->kind->tell(s));
            read = w->source[i];
            w->now[i] = w->factor[i] * s->told[w->told[i]] + w->offset[i];
        }
        if (status == PH_OK)
            status = write(m, w->now, w->stage[g], w->stage[g + 1]);
    }
    return status;
}

int ph_held_after(ph_master *m, double h, int row) {
    ph_held *w = m->held;
    int status;
    if (!w)
        return PH_OK;
    memcpy(w->before, w->now, bytes(w->n));
    w->last = h;
    w->known = 1;
    status = ph_held_sample(m);
    memcpy(w->row + (ptrdiff_t)row * w->n, w->now, bytes(w->n));
    return status;
}

/* Samples and inputs of ports are those before the step; what else members took is in their states. */
void ph_held_drop(ph_master *m) {
    ph_held *w = m->held;
    if (!w)
        return;
    w->known = w->known_kept;
    w->last = w->last_kept;
    memcpy(w->now, w->now_kept, bytes(w->n));
    memcpy(w->before, w->before_kept, bytes(w->n));
    for (int i = 0; i < w->n; i++)
        if (w->taken[i] < 0)
            m->shares[w->target[i]].free[w->input[i]] = w->now[i];
}
