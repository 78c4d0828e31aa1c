/* Steps of a network, lent to a model that lands for its members. */
#include "lent_network.h"

#include <stdlib.h>
#include <string.h>

#include "event_landing.h"

const ph_whole_member *ph_lent_member(const ph_lent_network *l, int i) {
    return &l->w->members[l->about->members[i]];
}

void ph_lent_gather(ph_lent_network *l) {
    double *x = l->x, *p = l->p;
    for (int i = 0; i < l->about->n; i++) {
        const ph_whole_member *m = ph_lent_member(l, i);
        ph_copy(x, m->map->signals(m->of), m->sizes.nx);
        ph_copy(p, m->map->parameters(m->of), m->sizes.np);
        x += m->sizes.nx;
        p += m->sizes.np;
    }
}

int ph_lent_states(ph_lent_network *l, double t) {
    double *to = l->x;
    for (int i = 0; i < l->about->n; i++) {
        const ph_whole_member *m = ph_lent_member(l, i);
        ph_copy(to, m->map->signals(m->of), m->sizes.nx);
        to += m->sizes.nx;
    }
    return ph_set_x(l->in, t, l->x);
}

int ph_lent_step(void *world, double t, double h) {
    ph_lent_network *l = world;
    l->refused = ph_whole_step(l->w, t, h, 0);
    return l->refused ? l->refused : ph_lent_states(l, t + h);
}

static long long halved(void *world) {
    const ph_lent_network *l = world;
    long long n = 0;
    for (int i = 0; i < l->about->n; i++) {
        const ph_whole_member *m = ph_lent_member(l, i);
        n += m->map->counts(m->of)[PH_SUBSTEPS];
    }
    return n;
}

static void inside(void *world, double tau, double *x) {
    const ph_lent_network *l = world;
    for (int i = 0; i < l->about->n; i++) {
        const ph_whole_member *m = ph_lent_member(l, i);
        const ph_events *e = l->about->own[i];
        int at = 0;
        if (m->sizes.nx == 0)
            continue;
        while (at + 1 < e->npoint && e->fit_tau[at] != tau)
            at++;
        ph_events_inside(e, m->in->model->step->k, at, m->in->step.last, x);
        x += m->sizes.nx;
    }
}

static void save(void *world) {
    const ph_lent_network *l = world;
    ph_whole_put(l->w, l->before);
}

static void load(void *world) {
    const ph_lent_network *l = world;
    ph_whole_back(l->w, l->before);
}

int ph_lent_make(ph_lent_network *l, ph_whole *w, const ph_lander *about) {
    l->about = about;
    l->w = w;
    l->before = calloc(1, ph_whole_placed_size(w));
    l->steps = (ph_lent_steps){l, ph_lent_step, halved, inside, save, load};
    return l->before != NULL;
}

void ph_lent_release(ph_lent_network *l) {
    free(l->before);
}

void ph_lent_tell(const ph_lent_network *l, int i) {
    const ph_whole *w = l->w;
    const int own = l->about->members[i];
    const ph_whole_member *m = &w->members[own];
    const double *kept = w->kept + w->master.ncolumn + w->sizes.nu + w->about->njunction;
    for (int j = 0; j < own; j++)
        kept += w->members[j].map->kept_size(w->members[j].about);
    if (!l->told)
        return;
    if (m->in)
        ph_clear_ledger(m->in);
    else
        w->about->lander->clear(m->of);
    m->map->join(m->of, kept, 1.0);
}

void ph_lent_join(ph_lent_network *l, double t, double now) {
    ph_whole *w = l->w;
    if (l->told)
        ph_whole_join(w, w->kept, (t - l->begun) / (now - l->begun));
    ph_whole_keep(w, w->kept);
    l->told = 1;
}

void ph_lent_book(const ph_lent_network *l, double t, const double *energy, const double *lost) {
    ph_happened *to = &l->w->happened;
    to->count++;
    to->last = t;
    for (int i = 0; i < l->about->n; i++) {
        const ph_whole_member *m = ph_lent_member(l, i);
        for (int c = 0; c < m->sizes.ncomp; c++) {
            to->energy[m->comp + c] += *energy++;
            to->lost[m->comp + c] += *lost++;
        }
    }
}

int ph_lent_land(ph_lent_network *l, double t, double h, int n,
                 int (*grid_step)(ph_lent_network *l, double t, double end)) {
    ph_whole *w = l->w;
    int status = ph_whole_save(w, w->before);
    l->begun = t;
    l->told = 0;
    for (int i = 0; i < n && status == PH_OK; i++)
        status = grid_step(l, t + i * (h / n), i + 1 < n ? t + (i + 1) * (h / n) : t + h);
    if (status == PH_OK)
        return PH_OK;
    if (status == PH_EVENT)
        w->part = w->about->nmember;
    ph_whole_load(w, w->before);
    w->report.solved = 0;
    return status;
}
