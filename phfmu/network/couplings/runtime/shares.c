/* What members do in a step each for itself, by all threads that help: with what comes of it in the order of
 * the members, the results are the same bits whoever took which. */
#define _POSIX_C_SOURCE 199309L
#include <time.h>

#include "master.h"
#include "system.h"

typedef struct step {
    ph_master *m;
    double t;
    double h;
    ph_from from;
    const int *which;
} step;

/* Of this thread where the system tells, so that what else the machine does counts for nothing. */
static double seconds(void) {
    struct timespec now;
#ifdef CLOCK_THREAD_CPUTIME_ID
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
#else
    timespec_get(&now, TIME_UTC);
#endif
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void one_keep(void *with, int i) {
    ph_master *m = with;
    m->status[i] = m->shares[i].kind->keep(&m->shares[i]);
}

static void one_step(void *with, int at) {
    const step *s = with;
    ph_master *m = s->m;
    const int i = s->which ? s->which[at] : at;
    const ph_share *share = &m->shares[i];
    const double before = m->cost ? seconds() : 0.0;
    int status = PH_OK;
    if (s->from != PH_GOING_ON)
        status = s->from == PH_FROM_KEPT ? share->kind->restore(share) : share->kind->keep(share);
    m->status[i] = status ? status : ph_share_step(m, share, s->t, s->h);
    if (m->cost)
        m->cost[i] += seconds() - before;
}

static void one_along(void *with, int i) {
    ph_master *m = with;
    m->status[i] = ph_share_along(m, &m->shares[i]);
}

static void one_refresh(void *with, int i) {
    ph_master *m = with;
    m->status[i] = m->shares[i].kind->refresh(&m->shares[i]);
}

typedef struct finish {
    ph_master *m;
    int row;
} finish;

static void one_finish(void *with, int i) {
    const finish *f = with;
    const ph_share *share = &f->m->shares[i];
    f->m->status[i] = share->kind->record(share, share->record + (ptrdiff_t)f->row * share->length);
}

static int first_failure(const ph_master *m) {
    for (int i = 0; i < m->nshare; i++)
        if (m->status[i])
            return m->status[i];
    return PH_OK;
}

int ph_shares_keep(ph_master *m) {
    ph_crew_each(m->crew, m->nshare, one_keep, m);
    return first_failure(m);
}

int ph_shares_step(ph_master *m, double t, double h, ph_from from, const int *which, int n) {
    step s = {m, t, h, from, which};
    ph_crew_each(m->crew, n, one_step, &s);
    return first_failure(m);
}

int ph_shares_refresh(ph_master *m) {
    ph_crew_each(m->crew, m->nshare, one_refresh, m);
    return first_failure(m);
}

int ph_shares_finish(ph_master *m, int row) {
    finish f = {m, row};
    ph_crew_each(m->crew, m->nshare, one_finish, &f);
    return first_failure(m);
}

int ph_shares_along(ph_master *m) {
    ph_crew_each(m->crew, m->nshare, one_along, m);
    return first_failure(m);
}
