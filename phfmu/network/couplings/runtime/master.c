/* The steps of coupled members: trials until one is accepted, and rows of what was. */
#include <math.h>
#include <string.h>

#include "master.h"
#include "system.h"

int ph_master_refuser(const ph_master *m) {
    for (int i = 0; i < m->nshare; i++)
        if (m->status[i])
            return i + 1;
    return 0;
}

void ph_master_restore(ph_master *m) {
    for (int i = 0; i < m->nshare; i++)
        m->shares[i].kind->restore(&m->shares[i]);
}

static size_t unknowns(const ph_master *m) {
    return sizeof(double) * (size_t)(m->nxi + 2 * m->nbare);
}

/* One more trial: what it leaves, and z if that is the least of all. */
static void note(ph_master *m, ph_progress *p, double scaled) {
    double least = INFINITY;
    for (int i = 0; i < p->trials; i++)
        least = fmin(least, m->history[i]);
    if (p->trials == 0 || scaled < least)
        memcpy(m->best, m->z, unknowns(m));
    m->history[p->trials] = scaled;
    ph_coupled_note(m->rules, p, scaled);
    m->ntrial = p->trials;
}

/* z of one step, from z; how many trials it took and by which test it was accepted. */
static int solve(ph_master *m, double t, double h, int again, int *by) {
    const ph_solver *solver = m->solver;
    const ph_rules *rules = m->rules;
    ph_progress p = {0};
    m->ntrial = 0;
    m->time = t;
    m->length = h;
    while (p.trials < rules->iterations) {
        ph_trial now;
        int left, floor, status = solver->take(m, t, h, again || p.trials > 0, &now);
        if (status || !solver->move)
            return status;
        note(m, &p, now.scaled);
        if (p.trials == rules->sweeps)
            return PH_OK;
        floor = p.stalled && p.matrices > 0 && ph_matrix_at_floor(m);
        left = ph_coupled_asks_energy(rules, &p) ? ph_trial_left(m, &p, &now) : PH_TOO_MUCH;
        *by = ph_coupled_accepted(rules, &p, floor, left);
        if (*by != PH_NOT_YET)
            return PH_OK;
        status = solver->move(m, &p, left);
        if (status)
            return status;
    }
    return PH_NO_CONVERGENCE;
}

/* A step that was refused is tried once more where the solver knows another start; of one that does not
 * converge the best trial is kept where the rules say so. */
static int solve_or_keep(ph_master *m, double t, double h, int next, int *by) {
    const ph_solver *solver = m->solver;
    int status = solve(m, t, h, 0, by);
    if (status && solver->again && solver->again(m, next)) {
        memset(m->status, 0, sizeof(int) * (size_t)m->nshare);
        status = solve(m, t, h, 1, by);
    }
    if (status == PH_NO_CONVERGENCE && m->rules->accept && !ph_master_refuser(m)) {
        ph_trial now;
        memcpy(m->z, m->best, unknowns(m));
        status = solver->take(m, t, h, 1, &now);
        *by = PH_UNCONVERGED;
    }
    return status;
}

static void record(ph_master *m, double h, int row) {
    double *xi = m->xi + (ptrdiff_t)row * 2 * m->ncolumn, *end = xi + m->ncolumn;
    ph_clear(xi, 2 * m->ncolumn);
    for (int i = 0; i < m->nxi; i++) {
        xi[m->column[i]] += m->weights[i] * m->z[i];
        end[m->column[i]] += m->at_end[i] * m->z[i];
    }
    for (int b = 0; b < m->nbare; b++)
        xi[m->bare_column[b]] += (m->z[m->nxi + b] + m->z[m->nxi + m->nbare + b]) / h;
}

void ph_master_forget(ph_master *m) {
    if (m->solver->forget)
        m->solver->forget(m);
}

int ph_master_remembered(const ph_master *m) {
    return m->solver->remembered ? m->solver->remembered(m) : 0;
}

void ph_master_save(const ph_master *m, double *to) {
    if (m->solver->save)
        m->solver->save(m, to);
}

void ph_master_load(ph_master *m, const double *from) {
    if (m->solver->load)
        m->solver->load(m, from);
}

int ph_master_sound(const ph_master *m, const double *from) {
    return !m->solver->sound || m->solver->sound(m, from);
}

void ph_master_further(ph_master *m, double ratio) {
    m->solver->further(m, ratio);
}

void ph_master_spread(ph_master *m, const double *xi) {
    for (int i = 0; i < m->nxi; i++)
        m->z[i] = xi[m->column[i]];
    ph_clear(m->z + m->nxi, 2 * m->nbare);
}

int ph_master_run(ph_master *m, double t0, double h, int n, long long first, int next) {
    const ph_solver *solver = m->solver;
    int done = 0, status;
    if (m->clock)
        ph_clock_start(m->clock);
    m->row = m->ntrial = 0;
    memset(m->status, 0, sizeof(int) * (size_t)m->nshare);
    status = solver->begin ? solver->begin(m) : PH_OK;
    for (; done < n && status == PH_OK; done++) {
        int by = PH_NOT_YET;
        m->row = done;
        solver->start(m, done || next);
        status = ph_held_before(m, h);
        if (status) {
            ph_held_drop(m);
            break;
        }
        status = solve_or_keep(m, t0 + (double)(first + done) * h, h, done || next, &by);
        m->trials[done] = m->ntrial;
        if (status == PH_OK)
            status = ph_settle(m);
        if (status == PH_OK)
            status = ph_signals_present(m);
        if (status == PH_OK)
            status = ph_held_after(m, h, done);
        if (status == PH_OK)
            status = ph_shares_finish(m, done);
        if (status) {
            ph_master_restore(m);
            ph_held_drop(m);
            if (solver->drop)
                solver->drop(m);
            break;
        }
        m->accepted[done] = by;
        record(m, h, done);
        ph_work_record(m, h, done);
        if (solver->keep)
            solver->keep(m, done || next);
    }
    m->refused = status;
    ph_lap(m->clock, PH_JOINING);
    return done;
}
