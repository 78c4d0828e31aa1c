/* Members that are units of this package. */
#include "unit.h"

#include <string.h>

#include "master.h"
#include "system.h"

static int joining(const ph_share *s, int status) {
    ph_lap(s->clock, PH_JOINING);
    return status;
}

static int set(const ph_share *s, const ph_scalars *what, const double *from) {
    ph_unit *u = s->of;
    for (int i = 0; i < what->n; i++)
        what->value[what->place[i]] = from[what->at[i]] / what->sign[i];
    if (what->n == 0)
        return PH_OK;
    ph_lap(s->clock, PH_EXCHANGING);
    return joining(s, u->version->set(u, what));
}

static void place(const ph_scalars *what, double *to) {
    for (int i = 0; i < what->n; i++)
        to[what->at[i]] = what->value[what->place[i]] * what->sign[i];
}

static int get(const ph_share *s, const ph_scalars *what, double *to) {
    ph_unit *u = s->of;
    int status = PH_OK;
    if (what->n) {
        ph_lap(s->clock, PH_EXCHANGING);
        status = joining(s, u->version->get(u, what));
    }
    if (status == PH_OK)
        place(what, to);
    return status;
}

static int keep(const ph_share *s) {
    ph_unit *u = s->of;
    ph_lap(s->clock, PH_EXCHANGING);
    return joining(s, u->version->save(u));
}

static int restore(const ph_share *s) {
    ph_unit *u = s->of;
    ph_lap(s->clock, PH_EXCHANGING);
    return joining(s, u->version->restore(u));
}

static int step(const ph_share *s, double t, double h) {
    ph_unit *u = s->of;
    int status = set(s, u->input, s->u);
    if (status == PH_OK && s->nkick) {
        memcpy(u->impulses, s->s, sizeof(double) * 2 * (size_t)s->nkick);
        status = set(s, u->impulse, u->impulses);
    }
    if (status)
        return status;
    u->time = t;
    u->length = h;
    ph_lap(s->clock, PH_STEPPING);
    status = joining(s, u->version->step(u, t, h));
    return status ? status : get(s, u->output, u->y);
}

static int refresh(const ph_share *s) {
    ph_unit *u = s->of;
    return get(s, u->present, u->now);
}

static int jump(const ph_share *s) {
    ph_unit *u = s->of;
    int status = get(s, u->jump, s->jump);
    for (int i = 0; i < s->nkick; i++)
        for (int j = 0; j < i; j++)
            s->jump[j * s->nkick + i] = s->jump[i * s->nkick + j];
    return status;
}

/* Units know impulses of the coming step only: it is taken again. */
static int more(const ph_share *s) {
    ph_unit *u = s->of;
    int status = restore(s);
    for (int i = 0; i < s->nkick; i++) {
        s->s[s->nkick + i] = u->impulses[s->nkick + i] + s->s[i];
        s->s[i] = u->impulses[i];
    }
    return status ? status : step(s, u->time, u->length);
}

static int present(const ph_share *s) {
    ph_unit *u = s->of;
    return set(s, u->held, s->now);
}

static int along(const ph_share *s) {
    ph_unit *u = s->of;
    const int all = s->ninput + 2 * s->nbare, kn = s->k * s->nu;
    const ph_scalars *unknown = u->unknown;
    ph_clear(s->dy, all * kn);
    ph_clear(s->dend, all * s->nu);
    for (int d = 0; d < all; d++) {
        const ph_scalars *known = &u->known[d];
        int status;
        ph_lap(s->clock, PH_STEPPING);
        status = joining(s, u->version->derivative(u, unknown, known));
        if (status)
            return status;
        for (int i = 0; i < unknown->n; i++) {
            const int at = unknown->at[i];
            const double value = unknown->value[unknown->place[i]] / known->sign[0] * unknown->sign[i];
            *(at < kn ? s->dy + d * kn + at : s->dend + d * s->nu + at - kn) = value;
        }
    }
    return PH_OK;
}

/* What is recorded, and the inputs that it belongs to, outputs of the step behind it. */
static int record(const ph_share *s, double *to) {
    ph_unit *u = s->of;
    const size_t kn = (size_t)(s->k * s->nu);
    int status = get(s, u->row, to);
    memcpy(to + u->nrow, s->u, sizeof(double) * kn);
    memcpy(to + u->nrow + kn, u->y, sizeof(double) * kn);
    return status;
}

static int tell(const ph_share *s) {
    const ph_unit *u = s->of;
    return get(s, u->told, s->told);
}

static int take(const ph_share *s) {
    const ph_unit *u = s->of;
    return set(s, u->taken, s->taken);
}

const ph_kind *ph_kind_unit(void) {
    static const ph_kind unit = {keep,  restore, step,   refresh, jump, more,
                                 along, present, record, tell,    take};
    return &unit;
}
