/* The steps of coupled members: Newton's method over their unknowns, and rows of what was accepted. */
#include <string.h>

#include "master.h"
#include "system.h"

/* All members, also if one of them cannot be brought back. */
static void restore(ph_master *m) {
    for (int i = 0; i < m->nshare; i++)
        m->shares[i].kind->restore(&m->shares[i]);
}

/* z of one step, from z; how many trials it took and by which test it was accepted. */
static int solve(ph_master *m, double t, double h, int *trials, int *by) {
    const ph_rules *rules = m->rules;
    ph_progress p = {0};
    while (p.trials < rules->iterations) {
        ph_trial now;
        int left, floor, status = ph_trial_take(m, t, h, p.trials > 0, &now);
        if (status)
            return status;
        ph_coupled_note(rules, &p, now.scaled);
        floor = p.stalled && p.matrices > 0 && ph_matrix_at_floor(m);
        left = ph_coupled_asks_energy(rules, &p) ? ph_trial_left(m, &now) : PH_TOO_MUCH;
        *by = ph_coupled_accepted(rules, &p, floor, left);
        *trials = p.trials;
        if (*by != PH_NOT_YET)
            return PH_OK;
        if (ph_coupled_takes_matrix(rules, &p, left)) {
            status = ph_matrix_take(m);
            p.matrices++;
        }
        if (status == PH_OK)
            status = ph_matrix_update(m);
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

int ph_master_run(ph_master *m, double t0, double h, int n, long long first, int next) {
    int done = 0, status;
    if (m->clock)
        ph_clock_start(m->clock);
    status = ph_trial_before(m);
    for (; done < n && status == PH_OK; done++) {
        int by = PH_NOT_YET;
        double *swap;
        m->row = done;
        if (done || next)
            ph_continue_ahead(m);
        status = solve(m, t0 + (double)(first + done) * h, h, &m->trials[done], &by);
        if (status == PH_OK)
            status = ph_settle(m);
        if (status == PH_OK)
            status = ph_signals_present(m);
        if (status == PH_OK)
            status = ph_shares_finish(m, done);
        if (status) {
            restore(m);
            break;
        }
        m->accepted[done] = by;
        record(m, h, done);
        ph_work_record(m, h, done);
        ph_continue_keep(m, done || next);
        memcpy(m->sums, m->rows + m->nxi, sizeof(double) * (size_t)m->nbare);
        swap = m->S0;
        m->S0 = m->S1;
        m->S1 = swap;
    }
    ph_lap(m->clock, PH_JOINING);
    return done;
}
