/* Junction unknowns at the start of a run, which no step has ended at: those of the instant, as composed
 * models have them. They are the limit, for h -> 0, of the polynomials of steps at their start,
 *
 *     xi(0) = lim p_h(t0),
 *
 * extrapolated from steps h, h/2, ... by Neville's scheme. */
#include <math.h>
#include <string.h>

#include "master.h"
#include "system.h"

/* Of the largest unknown of a kind: estimates that differ by less are one, those that differ by more none. */
#define PH_START_FOUND 1e-12
#define PH_START_TRUSTED 1e-6

static size_t bytes(int n) {
    return sizeof(double) * (size_t)n;
}

/* A step from the start that is taken back: means, and the polynomials at its start. */
static int try(ph_master *m, double t0, double h, const double *guess, double *mean, double *begin) {
    int status;
    ph_master_spread(m, guess);
    status = ph_master_run(m, t0, h, 1, 0, 0) == 1 ? PH_OK : m->refused;
    if (status)
        return status;
    ph_master_restore(m);
    ph_held_drop(m);
    if (mean)
        memcpy(mean, m->xi, bytes(m->ncolumn));
    ph_clear(begin, m->ncolumn);
    for (int i = 0; i < m->nxi; i++)
        begin[m->column[i]] += m->at_begin[i] * m->z[i];
    return PH_OK;
}

/* Of a solver that solves for them. */
static int at_instant(ph_master *m, const double *guess, double *mean, double *begin) {
    int status;
    memset(m->status, 0, sizeof(int) * (size_t)m->nshare);
    ph_master_spread(m, guess);
    status = m->solver->instant(m);
    memcpy(mean, guess, bytes(m->ncolumn));
    for (int i = 0; i < m->nxi && status == PH_OK; i++)
        mean[m->column[i]] = m->z[i];
    memcpy(begin, mean, bytes(m->ncolumn));
    m->refused = status;
    return status;
}

static double moved(const ph_master *m, const double *to, const double *from) {
    double most = 0.0;
    for (int i = 0; i < m->ncolumn; i++) {
        const double size = fabs(to[i]) > m->nominal[i] ? fabs(to[i]) : m->nominal[i];
        const double change = fabs(to[i] - from[i]) / size;
        if (!(change <= most))
            most = change;
    }
    return most;
}

int ph_master_prepare(ph_master *m, double t0, double h, int steps, const double *guess, double *mean,
                      double *begin) {
    const int n = m->ncolumn;
    double *row = m->tried, *next = m->tried + PH_START_TRIALS * n, best = INFINITY;
    int status;
    for (int i = 0; i < m->nshare; i++)
        if (m->shares[i].kind->forget)
            m->shares[i].kind->forget(&m->shares[i]);
    if (m->solver->instant)
        return at_instant(m, guess, mean, begin);
    status = try(m, t0, h, guess, mean, row);
    if (status)
        return status;
    memcpy(begin, mean, bytes(n)); /* where steps tend to nothing */
    for (int j = 1; j < steps; j++) {
        double change, *swap = row;
        if (try(m, t0, ldexp(h, -j), guess, NULL, next))
            break;
        for (int l = 0; l < j; l++)
            for (int i = 0; i < n; i++) {
                const double last = next[l * n + i];
                next[(l + 1) * n + i] = last + (last - row[l * n + i]) / (ldexp(1.0, l + 1) - 1.0);
            }
        change = moved(m, next + j * n, row + (j - 1) * n);
        if (change < best) {
            best = change;
            if (best <= PH_START_TRUSTED)
                memcpy(begin, next + j * n, bytes(n));
        } else if (best <= PH_START_TRUSTED)
            break;
        if (best <= PH_START_FOUND)
            break;
        row = next;
        next = swap;
    }
    return PH_OK;
}
