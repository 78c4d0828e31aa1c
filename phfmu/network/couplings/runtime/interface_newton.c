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

/* z = the polynomials of the last step at the nodes of one that is `ratio` times as long, without impulses.
 */
static void further(ph_master *m, double ratio) {
    ph_clear(m->z, m->nxi + 2 * m->nbare);
    for (int first = 0, k; first < m->nxi; first += k) {
        for (k = 1; first + k < m->nxi && m->column[first + k] == m->column[first]; k++)
            ;
        for (int i = first; i < first + k; i++)
            for (int j = first; j < first + k; j++) {
                double basis = 1.0;
                for (int l = first; l < first + k; l++)
                    if (l != j)
                        basis *= (1.0 + ratio * m->node[i] - m->node[l]) / (m->node[j] - m->node[l]);
                m->z[i] += basis * m->found[j];
            }
    }
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

static void forget(ph_master *m) {
    m->known = 0;
}

/* How many of the rows of `missed` are known, `found`, `missed`. */
static int remembered(const ph_master *m) {
    return 1 + (PH_COUPLED_KNOWN + 1) * (m->nxi + 2 * m->nbare);
}

static void save(const ph_master *m, double *to) {
    const int all = m->nxi + 2 * m->nbare;
    to[0] = m->known;
    memcpy(to + 1, m->found, bytes(all));
    memcpy(to + 1 + all, m->missed, bytes(all * PH_COUPLED_KNOWN));
}

static void load(ph_master *m, const double *from) {
    const int all = m->nxi + 2 * m->nbare;
    m->known = (int)from[0];
    memcpy(m->found, from + 1, bytes(all));
    memcpy(m->missed, from + 1 + all, bytes(all * PH_COUPLED_KNOWN));
}

static int sound(const ph_master *m, const double *from) {
    (void)m;
    return ph_counted(from[0], PH_COUPLED_KNOWN);
}

const ph_solver *ph_solver_newton(void) {
    static const ph_solver newton = {
        .begin = ph_trial_before,
        .start = start,
        .take = ph_trial_take,
        .move = move,
        .again = again,
        .keep = keep,
        .forget = forget,
        .remembered = remembered,
        .save = save,
        .load = load,
        .sound = sound,
        .further = further,
    };
    return &newton;
}
