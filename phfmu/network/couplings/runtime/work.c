/* What coupled members exchanged in an accepted step, part by part; see junction_works.py. */
#include "master.h"

/* (S x)_b; the bare columns of a cluster are neighbours. */
static double times(const ph_master *m, const double *S, const double *x, int b, int cluster) {
    const int from = m->cluster[cluster], n = m->cluster[cluster + 1] - from;
    const double *row = S + m->square[cluster] + (b - from) * n;
    double sum = 0.0;
    for (int j = 0; j < n; j++)
        sum += row[j] * x[from + j];
    return sum;
}

void ph_work_record(const ph_master *m, double h, int row) {
    const int n = m->nxi, nb = m->nbare;
    const double *start = m->z + n, *end = start + nb;
    double *to = m->work ? m->work + (ptrdiff_t)row * (n + 2 * nb) : NULL;
    if (!to)
        return;
    for (int i = 0; i < n; i++)
        to[i] = h * m->weights[i] * m->z[i] * m->rows[i];
    for (int c = 0; c < m->ncluster; c++)
        for (int b = m->cluster[c]; b < m->cluster[c + 1]; b++) {
            to[n + b] = start[b] * (m->sums[b] + times(m, m->S0, start, b, c) / 2.0);
            to[n + nb + b] = end[b] * (m->rows[n + b] - times(m, m->S1, end, b, c) / 2.0);
        }
}
