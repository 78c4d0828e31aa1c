/* A trial: one step of all members under the unknowns, what its rows leave, and how much energy that is. */
#include <math.h>

#include "master.h"
#include "system.h"

int ph_all_finite(const double *values, int n) {
    double sum = 0.0;
    for (int i = 0; i < n; i++)
        sum += values[i] - values[i];
    return sum == 0.0;
}

/* x S x on the clusters. */
static double form(const ph_master *m, const double *S, const double *x) {
    double sum = 0.0;
    for (int c = 0; c < m->ncluster; c++) {
        const int from = m->cluster[c], n = m->cluster[c + 1] - from;
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++)
                sum += x[from + i] * S[m->square[c] + i * n + j] * x[from + j];
    }
    return sum;
}

/* S and sums of the members where they are. */
int ph_trial_before(ph_master *m) {
    ph_clear(m->S0, m->square[m->ncluster]);
    ph_clear(m->sums, m->nbare);
    for (int i = 0; i < m->nshare; i++) {
        int status = ph_share_said(m, i, ph_share_before(&m->shares[i], m->nxi, m->S0, m->sums));
        if (status)
            return status;
    }
    return PH_OK;
}

/* One step of all members under z, and what their rows leave; again: from where the trial before began. */
int ph_trial_take(ph_master *m, double t, double h, int again, ph_trial *found) {
    const int n = m->nxi, nb = m->nbare;
    const double *start = m->z + n, *end = start + nb;
    int status;
    ph_clear(m->rows, n + nb);
    ph_clear(m->size, n + nb);
    ph_clear(m->S1, m->square[m->ncluster]);
    *found = (ph_trial){.in_play = -1.0};
    for (int e = 0; e < m->nskew; e++) {
        const double term = m->skew[e] * m->z[m->skew_col[e]];
        m->rows[m->skew_row[e]] += term;
        m->size[m->skew_row[e]] += fabs(term);
    }
    status = ph_shares_step(m, t, h, again ? PH_FROM_KEPT : PH_FROM_HERE, NULL, m->nshare);
    if (status)
        return status;
    for (int i = 0; i < m->nshare; i++)
        ph_share_add_rows(m, &m->shares[i], h, &found->through);
    ph_lap(m->clock, PH_SOLVING);
    status = ph_pair_moved(m);
    ph_lap(m->clock, PH_JOINING);
    if (status)
        return status;
    for (int i = 0; i < n; i++)
        found->left += fabs(h) * m->weights[i] * fabs(m->z[i] * m->rows[i]);
    for (int b = 0; b < nb; b++) {
        m->rows[n + nb + b] = end[b] - m->signs[b] * m->moved[b];
        found->left += fabs(start[b] * m->sums[b]) + fabs(end[b] * m->rows[n + b]);
    }
    if (nb)
        found->left += fabs(form(m, m->S0, start) - form(m, m->S1, end)) / 2.0;
    for (int i = 0; i < n + nb; i++) {
        const double scaled = fabs(m->rows[i]) / (m->size[i] + m->least[i]);
        if (scaled > found->scaled)
            found->scaled = scaled;
    }
    return ph_all_finite(m->rows, n + 2 * nb) ? PH_OK : PH_NOT_FINITE;
}

/* How much energy the rows leave. Stored energies are asked for only where power does not do, and of an
 * iteration without a matrix, which may stall on its way, only where rows are solved: a part of what a rotor
 * stores is more than a line passes in a step. */
int ph_trial_left(ph_master *m, const ph_progress *p, ph_trial *now) {
    const double budget = PH_COUPLED_ENERGY;
    if (now->left <= budget * now->through)
        return PH_WITHIN;
    if (p->matrices == 0 && now->scaled > PH_COUPLED_ROUNDING)
        now->in_play = now->through;
    if (now->in_play < 0.0) {
        double stored = 0.0;
        if (ph_shares_refresh(m))
            return PH_TOO_MUCH;
        for (int i = 0; i < m->nshare; i++)
            for (int c = 0; c < m->shares[i].ncomp; c++)
                stored += fabs(m->shares[i].energies[c]);
        now->in_play = stored > now->through ? stored : now->through;
    }
    if (now->left <= budget * now->in_play)
        return PH_WITHIN;
    return now->left <= PH_COUPLED_STALLED * budget * now->in_play ? PH_WHERE_STALLED : PH_TOO_MUCH;
}
