/* The steps of coupled members: trials until one is accepted, and rows of what was. */
#include <string.h>

#include "master.h"
#include "system.h"

void ph_master_restore(ph_master *m) {
    for (int i = 0; i < m->nshare; i++)
        m->shares[i].kind->restore(&m->shares[i]);
}

/* z of one step, from z; how many trials it took and by which test it was accepted. */
static int solve(ph_master *m, double t, double h, int *trials, int *by) {
    const ph_solver *solver = m->solver;
    const ph_rules *rules = m->rules;
    ph_progress p = {0};
    *trials = 0;
    while (p.trials < rules->iterations) {
        ph_trial now;
        int left, floor, status = solver->take(m, t, h, p.trials > 0, &now);
        if (status || !solver->move)
            return status;
        ph_coupled_note(rules, &p, now.scaled);
        floor = p.stalled && p.matrices > 0 && ph_matrix_at_floor(m);
        left = ph_coupled_asks_energy(rules, &p) ? ph_trial_left(m, &now) : PH_TOO_MUCH;
        *by = ph_coupled_accepted(rules, &p, floor, left);
        *trials = p.trials;
        if (*by != PH_NOT_YET)
            return PH_OK;
        status = solver->move(m, &p, left);
        if (status)
            return status;
    }
    return PH_NO_CONVERGENCE;
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
    m->row = 0;
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
        status = solve(m, t0 + (double)(first + done) * h, h, &m->trials[done], &by);
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
