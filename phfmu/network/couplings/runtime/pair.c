/* Impulse pairs: T m = 1/n sum_l (cos^2 t_l S1 + sin^2 t_l S0)^-1 S0 m, cluster by cluster. The matrices are
 * symmetric and, as inverse inductances, positive definite. */
#include <math.h>
#include <string.h>

#include "master.h"
#include "system.h"

/* L L^T = A in place, lower part. */
static int cholesky(double *A, int n) {
    for (int j = 0; j < n; j++) {
        for (int k = 0; k < j; k++)
            for (int i = j; i < n; i++)
                A[i * n + j] -= A[i * n + k] * A[j * n + k];
        if (!(A[j * n + j] > 0.0))
            return PH_SINGULAR;
        A[j * n + j] = sqrt(A[j * n + j]);
        for (int i = j + 1; i < n; i++)
            A[i * n + j] /= A[j * n + j];
    }
    return PH_OK;
}

/* b = (L L^T)^-1 b; its entries are `stride` apart. */
static void solve(const double *L, int n, double *b, int stride) {
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < i; k++)
            b[i * stride] -= L[i * n + k] * b[k * stride];
        b[i * stride] /= L[i * n + i];
    }
    for (int i = n - 1; i >= 0; i--) {
        for (int k = i + 1; k < n; k++)
            b[i * stride] -= L[k * n + i] * b[k * stride];
        b[i * stride] /= L[i * n + i];
    }
}

static int mix(const ph_master *m, int c, int l) {
    const int at = m->square[c], n = m->cluster[c + 1] - m->cluster[c];
    const double cosine = m->cosines[l];
    for (int i = at; i < at + n * n; i++)
        m->mixed[i] = cosine * m->S1[i] + (1.0 - cosine) * m->S0[i];
    return cholesky(m->mixed + at, n);
}

/* moved = T m; uses `move`. */
int ph_pair_moved(ph_master *m) {
    const double *impulse = m->z + m->nxi;
    ph_clear(m->moved, m->nbare);
    for (int c = 0; c < m->ncluster; c++) {
        const int from = m->cluster[c], at = m->square[c], n = m->cluster[c + 1] - from;
        for (int l = 0; l < m->points; l++) {
            int status = mix(m, c, l);
            if (status)
                return status;
            for (int i = 0; i < n; i++) {
                m->move[i] = 0.0;
                for (int j = 0; j < n; j++)
                    m->move[i] += m->S0[at + i * n + j] * impulse[from + j];
            }
            solve(m->mixed + at, n, m->move, 1);
            for (int i = 0; i < n; i++)
                m->moved[from + i] += m->move[i] / m->points;
        }
    }
    return PH_OK;
}

int ph_pair_left(ph_master *m) {
    const double *sums = m->rows + m->nxi;
    for (int c = 0; c < m->ncluster; c++) {
        const int from = m->cluster[c], at = m->square[c], n = m->cluster[c + 1] - from;
        int status;
        memcpy(m->mixed + at, m->S1 + at, sizeof(double) * (size_t)(n * n));
        status = cholesky(m->mixed + at, n);
        if (status)
            return status;
        for (int i = 0; i < n; i++)
            m->moved[from + i] = -sums[from + i];
        solve(m->mixed + at, n, m->moved + from, 1);
    }
    return PH_OK;
}

/* T as a matrix; uses `scaled`-free room of `T` only. */
int ph_pair_root(ph_master *m) {
    for (int c = 0; c < m->ncluster; c++) {
        const int at = m->square[c], n = m->cluster[c + 1] - m->cluster[c];
        ph_clear(m->T + at, n * n);
        for (int l = 0; l < m->points; l++) {
            int status = mix(m, c, l);
            if (status)
                return status;
            for (int j = 0; j < n; j++) {
                for (int i = 0; i < n; i++)
                    m->move[i] = m->S0[at + i * n + j];
                solve(m->mixed + at, n, m->move, 1);
                for (int i = 0; i < n; i++)
                    m->T[at + i * n + j] += m->move[i] / m->points;
            }
        }
    }
    return PH_OK;
}
