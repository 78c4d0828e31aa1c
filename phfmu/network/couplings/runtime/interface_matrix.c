/* The matrix of the rows: its entries, its factors, the update of the unknowns. */
#include <float.h>
#include <math.h>

#include "master.h"
#include "system.h"

/* Pivot of a direction of which the rows have no more than rounding just here, as of the chord of a straight
 * chain of rigid links: in the factors only, so that the rows are met all the same or the trial is refused.
 */
#define PH_FORCED 1e-8

size_t ph_master_lu_size(int n, int nnz, int capacity) {
    ph_lu lu = {.n = n, .nnz = nnz, .capacity = capacity};
    ph_pool counted = {NULL, 0};
    ph_take(&counted, sizeof(lu));
    ph_lu_take(&lu, &counted);
    return counted.used;
}

void ph_master_lu_init(ph_master *m) {
    ph_lu *lu = m->lu;
    ph_pool whole = {(char *)m->lu, 0};
    *lu = (ph_lu){.n = m->nxi + 2 * m->nbare, .nnz = m->nnz, .capacity = m->capacity};
    lu->colptr = m->colptr;
    lu->rowind = m->rowind;
    lu->order = m->order;
    lu->prefer = m->prefer;
    ph_take(&whole, sizeof(*lu));
    ph_lu_take(lu, &whole);
}

/* C; the members add to it. */
static void begin(ph_master *m) {
    ph_clear(m->a, m->nnz);
    for (int e = 0; e < m->nskew; e++)
        m->a[m->skew_entry[e]] += m->skew[e];
}

int ph_matrix_of(ph_master *m, int (*along)(ph_master *)) {
    int status;
    begin(m);
    status = along(m);
    for (int i = 0; i < m->nshare && status == PH_OK; i++)
        ph_share_add_matrix(m, &m->shares[i]);
    return status;
}

/* Derivatives of all rows with respect to z, of the last trial, and their factors. */
int ph_matrix_take(ph_master *m) {
    const int nb = m->nbare;
    int status = ph_matrix_of(m, ph_shares_along);
    if (status)
        return status;
    ph_lap(m->clock, PH_SOLVING);
    status = ph_pair_root(m);
    ph_lap(m->clock, PH_JOINING);
    if (status)
        return status;
    for (int c = 0; c < m->ncluster; c++) {
        const int from = m->cluster[c], size = m->cluster[c + 1] - from;
        for (int i = 0; i < size; i++)
            for (int j = 0; j < size; j++) {
                const int e = m->square[c] + i * size + j;
                m->a[m->law_entry[e]] = -m->signs[from + i] * m->T[e];
            }
    }
    for (int b = 0; b < nb; b++)
        m->a[m->own_entry[b]] = 1.0;
    status = ph_matrix_factor(m);
    if (status == PH_SINGULAR) /* rows depend on each other just here: a pivot of its own leads past it */
        status = ph_lu_forced(m->lu, m->scaled, PH_FORCED);
    return status;
}

int ph_matrix_plain(ph_master *m) {
    begin(m);
    return ph_matrix_factor(m);
}

/* Factors of the matrix with rows scaled by their largest entries. Pivots are searched for, not kept: they
 * are those of this matrix whatever was factored before, so that a step does not depend on where a run began.
 */
int ph_matrix_factor(ph_master *m) {
    const int all = m->nxi + 2 * m->nbare;
    ph_lu *lu = m->lu;
    long long count[PH_NCOUNT] = {0};
    int status;
    ph_clear(m->scale, all);
    for (int e = 0; e < m->nnz; e++)
        if (fabs(m->a[e]) > m->scale[m->rowind[e]])
            m->scale[m->rowind[e]] = fabs(m->a[e]);
    for (int i = 0; i < all; i++)
        m->scale[i] = 1.0 / (m->scale[i] > 1e-300 ? m->scale[i] : 1e-300);
    for (int e = 0; e < m->nnz; e++)
        m->scaled[e] = m->a[e] * m->scale[m->rowind[e]];
    if (!ph_all_finite(m->scaled, m->nnz))
        return PH_NOT_FINITE;
    ph_lap(m->clock, PH_SOLVING);
    lu->ready = 0;
    status = ph_lu_factor(lu, m->scaled, count);
    ph_lap(m->clock, PH_JOINING);
    return status;
}

/* move = matrix^-1 rows, which are scaled. */
void ph_matrix_solve(ph_master *m) {
    const int all = m->nxi + 2 * m->nbare;
    for (int i = 0; i < all; i++)
        m->rows[i] *= m->scale[i];
    ph_lap(m->clock, PH_SOLVING);
    ph_lu_solve(m->lu, m->rows, m->move);
    ph_lap(m->clock, PH_JOINING);
}

/* Whether rows are what a relative change of the unknowns by eps makes of them, with the last matrix. Members
 * solve for all nodes of a step at once: rows of one column have the rounding of the largest. */
int ph_matrix_at_floor(ph_master *m) {
    const int n = m->nxi + m->nbare, all = n + m->nbare;
    ph_clear(m->move, all);
    for (int j = 0; j < all; j++)
        for (int e = m->colptr[j]; e < m->colptr[j + 1]; e++)
            m->move[m->rowind[e]] += fabs(m->a[e]) * fabs(m->z[j]);
    for (int i = 0, end; i < n; i = end) {
        double size = m->move[i];
        for (end = i + 1; end < m->nxi && m->column[end] == m->column[i]; end++)
            size = m->move[end] > size ? m->move[end] : size;
        for (int j = i; j < end; j++)
            if (fabs(m->rows[j]) > PH_COUPLED_FLOOR * DBL_EPSILON * size)
                return 0;
    }
    return 1;
}
