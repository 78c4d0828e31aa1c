/* Members that are instances of native engines. */
#include "native.h"

#include <string.h>

#include "master.h"
#include "system.h"

static size_t bytes(int n) {
    return sizeof(double) * (size_t)n;
}

static int joining(const ph_share *s, int status) {
    ph_lap(s->clock, PH_JOINING);
    return status;
}

static int keep(const ph_share *s) {
    const ph_native *m = s->of;
    ph_lap(s->clock, PH_EXCHANGING);
    ph_save(m->in, m->kept);
    if (m->impulses)
        memcpy(m->kept_values, m->values, bytes(4 * m->impulses));
    return joining(s, PH_OK);
}

static int restore(const ph_share *s) {
    const ph_native *m = s->of;
    ph_lap(s->clock, PH_EXCHANGING);
    if (m->impulses)
        memcpy(m->values, m->kept_values, bytes(4 * m->impulses));
    return joining(s, ph_load(m->in, m->kept));
}

static int step(const ph_share *s, double t, double h) {
    const ph_native *m = s->of;
    int status;
    ph_lap(s->clock, PH_EXCHANGING);
    status = (m->chain ? ph_set_node_inputs : ph_set_input)(m->in, s->u);
    if (status == PH_OK && s->nkick)
        status = ph_set_impulses(m->kicks, s->s);
    if (status)
        return joining(s, status);
    ph_lap(s->clock, PH_STEPPING);
    if (m->kicks)
        return joining(s, ph_step_impulses(m->kicks, t, h, m->parts));
    status = (m->exact ? ph_step_exactly : ph_step_parts)(m->in, t, h, m->parts);
    return joining(s, status);
}

static int refresh(const ph_share *s) {
    const ph_native *m = s->of;
    ph_lap(s->clock, PH_EXCHANGING);
    return joining(s, ph_refresh(m->in));
}

static int jump(const ph_share *s) {
    const ph_native *m = s->of;
    ph_lap(s->clock, PH_EXCHANGING);
    ph_jump(m->kicks, s->jump);
    return joining(s, PH_OK);
}

static int more(const ph_share *s) {
    const ph_native *m = s->of;
    ph_lap(s->clock, PH_EXCHANGING);
    return joining(s, ph_kick_more(m->kicks, s->s));
}

static int present(const ph_share *s) {
    const ph_native *m = s->of;
    ph_lap(s->clock, PH_EXCHANGING);
    return joining(s, ph_set_input(m->in, s->now));
}

/* dy of held inputs, one value each. */
static int held(const ph_share *s) {
    const ph_native *m = s->of;
    double *S = m->dx;
    int status = ph_sensitivity(m->in, S);
    for (int d = 0; d < s->ninput; d++)
        for (int i = 0; i < s->nu; i++)
            s->dy[d * s->nu + i] = S[i * s->nu + s->input[d]];
    return status;
}

/* dy and dend along all directions; impulses at the end change outputs there only, by their jump. */
static int at_nodes(const ph_share *s) {
    const ph_native *m = s->of;
    const int through = s->ninput + s->nbare, kn = s->k * s->nu;
    const ph_directions nodes = {.n = through, .du = m->du, .dx = m->dx, .dy = s->dy};
    const ph_directions end = {.n = through, .du = m->du, .dx = m->dx, .dy = s->dend};
    int status;
    ph_clear(m->dx, through * m->width);
    if (s->nkick)
        ph_impulses_along(m->kicks, 0, s->nbare, m->ds, m->dx + s->ninput * m->width);
    ph_save(m->in, m->copied);
    status = ph_load(m->chain, m->copied);
    if (status == PH_OK)
        status = ph_step_along(m->chain, &nodes);
    if (!s->nkick || status)
        return status;
    ph_clear(s->dy + through * kn, s->nbare * kn);
    ph_clear(s->dend + through * s->nu, s->nbare * s->nu);
    for (int j = 0; j < s->nbare; j++)
        for (int i = 0; i < s->nbare; i++)
            s->dend[(through + j) * s->nu + s->kicked_output[i]] =
                s->jump[s->kicked[i] * s->nkick + s->kicked[j]];
    ph_impulses_along(m->kicks, 1, through, m->ds_end, m->dx);
    return ph_end_along(m->chain, &end);
}

static int along(const ph_share *s) {
    const ph_native *m = s->of;
    ph_lap(s->clock, PH_STEPPING);
    return joining(s, m->chain ? at_nodes(s) : held(s));
}

/* Signals, then ledger rows. */
static int record(const ph_share *s, double *to) {
    const ph_native *m = s->of;
    int status = refresh(s);
    if (status)
        return status;
    memcpy(to, m->signals, bytes(m->nsignal));
    to += m->nsignal;
    for (int i = 0; i < PH_NROW; i++) {
        const int n = i == PH_ROW_PAIRS ? m->nq : s->ncomp;
        if (n)
            memcpy(to, ph_ledger(m->in, i), bytes(n));
        to += n;
    }
    return PH_OK;
}

static int tell(const ph_share *s) {
    const ph_native *m = s->of;
    int status = refresh(s);
    for (int i = 0; i < m->ntold && status == PH_OK; i++) {
        s->told[i] = 0.0;
        for (int j = 0; j < m->told_count[i]; j++)
            s->told[i] += m->signals[m->told_first[i] + j];
    }
    return status;
}

static int take(const ph_share *s) {
    const ph_native *m = s->of;
    ph_lap(s->clock, PH_EXCHANGING);
    memcpy(m->p, ph_parameters(m->in), bytes(m->np));
    for (int i = 0; i < m->ntaken; i++)
        m->p[m->taken[i]] = s->taken[i];
    return joining(s, ph_set_parameters(m->in, m->p));
}

static void forget(const ph_share *s) {
    const ph_native *m = s->of;
    ph_forget(m->in);
}

const ph_kind *ph_kind_native(void) {
    static const ph_kind native = {keep,  restore, step,   refresh, jump, more,
                                   along, present, record, tell,    take, forget};
    return &native;
}
