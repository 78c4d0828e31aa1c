/* Gauss-Seidel's and Jacobi's couplings, and others that step their members in turn. Before a group of
 * members steps, the unknowns are those of the instant (instant.c): of members that have not stepped yet at
 * t, of the others at t + h. They are held. Outputs are those of an instant, not means of a step: lagged by
 * one step, means lose their conjugacy and the coupling is less stable. */
#include "in_turn.h"

#include <string.h>

#include "instant.h"
#include "master.h"
#include "system.h"

static void start(ph_master *m, int next) {
    (void)next;
    ph_instant_begin(m);
}

/* A group under z, and what it takes. The first sweep has every member once, those after it begin where the
 * step began. */
static int step(ph_master *m, ph_in_turn *g, int group, double t, double h) {
    const int *which = g->member + g->group[group], n = g->group[group + 1] - g->group[group];
    const ph_from from = g->group[group] < m->nshare ? PH_GOING_ON : PH_FROM_KEPT;
    const int status = ph_shares_step(m, t, h, from, which, n);
    for (int i = 0; i < n && status == PH_OK; i++) {
        const ph_share *s = &m->shares[which[i]];
        for (int c = 0; c < s->ncol; c++)
            g->used[s->col[c]] = m->z[s->col[c]];
        memcpy(s->now, s->u, sizeof(double) * (size_t)s->nu);
        g->asked[which[i]] = PH_GIVEN;
        ph_instant_ask(g, which[i]);
    }
    return status;
}

/* At its end each has the inputs that it took. */
static int take(ph_master *m, double t, double h, int again, ph_trial *found) {
    ph_in_turn *g = m->memory;
    int status = ph_shares_keep(m);
    (void)again;
    (void)found;
    memcpy(g->used, m->z, sizeof(double) * (size_t)m->nxi);
    for (int i = 0; i < g->ngroup && status == PH_OK; i++) {
        status = ph_instant_solve(m);
        if (status == PH_OK)
            status = step(m, g, i, t, h);
    }
    for (int i = 0; i < m->nshare && status == PH_OK; i++)
        status = ph_share_said(m, i, ph_instant_give(m, i, m->shares[i].u));
    memcpy(m->z, g->used, sizeof(double) * (size_t)m->nxi);
    return status;
}

static int instant(ph_master *m) {
    ph_instant_begin(m);
    return ph_instant_solve(m);
}

static void unasked(const ph_master *m) {
    ph_in_turn *g = m->memory;
    for (int i = 0; i < m->nshare; i++)
        g->asked[i] = PH_UNGIVEN;
}

static void forget(ph_master *m) {
    ph_in_turn *g = m->memory;
    g->begun = 0;
    unasked(m);
}

/* Whether the matrix of the instant is factored, and the matrix. */
static int remembered(const ph_master *m) {
    return 1 + m->nnz;
}

static void save(const ph_master *m, double *to) {
    const ph_in_turn *g = m->memory;
    ph_clear(to, 1 + m->nnz);
    to[0] = g->begun;
    memcpy(to + 1, m->a, sizeof(double) * (size_t)(g->begun ? m->nnz : 0));
}

static void load(ph_master *m, const double *from) {
    ph_in_turn *g = m->memory;
    unasked(m);
    g->begun = 0;
    if (from[0] == 0.0)
        return;
    memcpy(m->a, from + 1, sizeof(double) * (size_t)m->nnz);
    g->begun = ph_instant_factor(m) == PH_OK;
}

static int sound(const ph_master *m, const double *from) {
    (void)m;
    return ph_counted(from[0], 1);
}

const ph_solver *ph_solver_in_turn(void) {
    static const ph_solver in_turn = {
        .start = start,
        .take = take,
        .instant = instant,
        .forget = forget,
        .remembered = remembered,
        .save = save,
        .load = load,
        .sound = sound,
    };
    return &in_turn;
}
