/* Newton's method over node values and impulses, or over held values (newton.py): the matrix is taken by the
 * rules, and a step starts from the continuation of the ones before. */
#include <string.h>

#include "master.h"
#include "system.h"

static size_t bytes(int n) {
    return sizeof(double) * (size_t)n;
}

/* z = the continuation of the last step, with the polynomial through what that missed in the steps known. */
static void ahead(ph_master *m) {
    const int all = m->nxi + 2 * m->nbare;
    memcpy(m->plain, m->found, bytes(all));
    ph_clear(m->plain, m->nxi);
    for (int e = 0; e < m->nahead; e++)
        m->plain[m->ahead_to[e]] += m->ahead[e] * m->found[m->ahead_from[e]];
    memcpy(m->z, m->plain, bytes(all));
    for (int j = 0, factor = m->known; j < m->known; j++) {
        for (int i = 0; i < all; i++)
            m->z[i] += factor * m->missed[j * all + i];
        factor = -factor * (m->known - j - 1) / (j + 2);
    }
}

static void start(ph_master *m, int next) {
    if (next)
        ahead(m);
}

static int move(ph_master *m, ph_progress *p, int left) {
    const int all = m->nxi + 2 * m->nbare;
    if (ph_coupled_takes_matrix(m->rules, p, left)) {
        const int status = ph_matrix_take(m);
        p->matrices++;
        if (status)
            return status;
    }
    ph_matrix_solve(m);
    for (int i = 0; i < all; i++)
        m->z[i] -= m->move[i];
    return ph_all_finite(m->z, all) ? PH_OK : PH_NOT_FINITE;
}

/* The continuation without what it will miss, where that was added. */
static int again(ph_master *m, int next) {
    if (!next || !m->known)
        return 0;
    memcpy(m->z, m->plain, bytes(m->nxi + 2 * m->nbare));
    return 1;
}

/* z is what was found; next: it was begun from the continuation. What the step ends with, the next one
 * begins with. */
static void keep(ph_master *m, int next) {
    const int all = m->nxi + 2 * m->nbare;
    double *swap = m->S0;
    if (next) {
        memmove(m->missed + all, m->missed, bytes(all * (PH_COUPLED_KNOWN - 1)));
        for (int i = 0; i < all; i++)
            m->missed[i] = m->z[i] - m->plain[i];
    }
    m->known = !next ? 0 : m->known < PH_COUPLED_KNOWN ? m->known + 1 : m->known;
    memcpy(m->found, m->z, bytes(all));
    memcpy(m->sums, m->rows + m->nxi, bytes(m->nbare));
    m->S0 = m->S1;
    m->S1 = swap;
}

const ph_solver *ph_solver_newton(void) {
    static const ph_solver newton = {ph_trial_before, start, ph_trial_take, move, again, keep, NULL};
    return &newton;
}
