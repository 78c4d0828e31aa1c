/* Choice of the mode that follows at an instant, soon after it. */
#include <math.h>
#include <string.h>

#include "work.h"

/* 1 if switch j may close by itself. */
static int may_close(const ph_modes *m, int j) {
    const ph_switches *sw = m->sw;
    for (int i = sw->when_ptr[j]; i < sw->when_ptr[j + 1]; i++)
        if (m->p[sw->when_p[i]] != sw->when_value[i])
            return 0;
    return 1;
}

/* The matrix of a backward Euler step of this length, whose rows are scaled, and its right side; 0: an empty
 * row.
 */
static int short_step(ph_modes *m, const ph_rates *r, const ph_mode_rows *mode, double step) {
    const int nx = m->sw->nx, na = m->sw->na, n = nx + na;
    double *a = m->matrix;
    for (int i = 0; i < nx; i++) {
        for (int j = 0; j < nx; j++)
            a[i * n + j] = -step * r->fx[j * nx + i];
        for (int j = 0; j < na; j++)
            a[i * n + nx + j] = -step * r->fa[j * nx + i];
        a[i * n + i] += r->mass[i];
        m->right[i] = step * r->f[i];
    }
    for (int i = 0; i < na; i++) {
        double *row = a + (nx + i) * n;
        for (int j = 0; j < nx; j++)
            row[j] = -r->gx[j * na + i];
        for (int j = 0; j < na; j++)
            row[nx + j] = -r->ga[j * na + i];
        m->right[nx + i] = r->g[i];
    }
    for (int d = 0; d < mode->nfree; d++) {
        const double *along = mode->free_row + d * na;
        const int at = nx + mode->free_at[d];
        for (int j = 0; j < na; j++) {
            a[at * n + nx + j] += along[j];
            m->right[at] -= along[j] * m->a[j];
        }
    }
    for (int i = 0; i < n; i++) {
        double largest = 0.0;
        for (int j = 0; j < n; j++)
            largest = fmax(largest, fabs(a[i * n + j]));
        if (!(largest > 0.0))
            return 0;
        for (int j = 0; j < n; j++)
            a[i * n + j] /= largest;
        m->right[i] /= largest;
    }
    return 1;
}

/* m->found = changes of states and algebraic variables over it; 0 if they have no one value. */
static int solve(ph_modes *m) {
    const int n = m->sw->nx + m->sw->na;
    for (int j = 0; j < n; j++) {
        m->scaling[j] = 0.0;
        for (int i = 0; i < n; i++)
            m->scaling[j] = fmax(m->scaling[j], fabs(m->matrix[i * n + j]));
        for (int i = 0; i < n && m->scaling[j] > 0.0; i++)
            m->matrix[i * n + j] /= m->scaling[j];
    }
    if (ph_dense_solve(n, m->matrix, m->right, 0.0, m->found, m->rows, m->columns) < n)
        return 0;
    for (int j = 0; j < n; j++) {
        m->found[j] /= m->scaling[j];
        if (!isfinite(m->found[j]))
            return 0;
    }
    return 1;
}

/* 1 if the rows in whose places others stand hold for the variables after the step, to rounding.  If not,
 * the rows contradict each other (sources in a ring of closed switches), and a variable that the added row
 * makes finite only seems to solve them.
 */
static int agree(const ph_modes *m, const ph_rates *r, const ph_mode_rows *mode) {
    const int nx = m->sw->nx, na = m->sw->na;
    for (int d = 0; d < mode->nfree; d++) {
        const double *along = mode->free_row + d * na;
        double left = 0.0, size = 0.0;
        for (int j = 0; j < na; j++) {
            const double a = m->a[j] + m->found[nx + j];
            left += along[j] * a;
            size += fabs(r->ga[j * na + mode->free_at[d]] * a) + fabs(along[j]) * (fabs(a) + m->sw->scale[j]);
        }
        if (!(fabs(left) <= PH_C * size))
            return 0;
    }
    return 1;
}

/* 1 if the switches that are asked obey their law a short step after the states x in m->tried, whose
 * parameters are in m->p. */
static int complies(ph_modes *m, const double *x, double step) {
    const ph_switches *sw = m->sw;
    const int nx = sw->nx;
    const ph_mode_rows *mode = m->source->rows(m->source->world, m->tried);
    ph_rates r;
    if (!mode)
        return 0;
    r = ph_mode_rates(m, x, m->p, m->t + step);
    if (!short_step(m, &r, mode, step) || !solve(m) || !agree(m, &r, mode))
        return 0;
    for (int j = 0; j < sw->n; j++) {
        double c = r.c[j];
        if (!sw->unilateral[j] || m->fixed[j])
            continue;
        if (m->tried[j]) {
            const int at = sw->multiplier[j];
            if (m->a[at] + m->found[nx + at] < -PH_MU * sw->scale[at])
                return 0;
            continue;
        }
        if (!may_close(m, j))
            continue; /* blocks in both directions */
        for (int i = 0; i < nx; i++)
            c += r.cx[i * sw->n + j] * m->found[i];
        for (int i = 0; i < sw->na; i++)
            c += r.ca[i * sw->n + j] * m->found[nx + i];
        if (c < -PH_C * sw->nominal[j] && (!sw->gaps[j] || r.gap[j] <= PH_C * sw->nominal[j]))
            return 0;
    }
    return 1;
}

/* m->tried = m->want with `many` of the asked ones flipped; whether those may be as they are then. */
static int flipped(ph_modes *m, int many) {
    const ph_switches *sw = m->sw;
    memcpy(m->tried, m->want, (size_t)sw->n);
    for (int i = 0; i < many; i++)
        m->tried[m->asked_of[m->flip[i]]] ^= 1;
    for (int j = 0; j < sw->n; j++)
        if (m->tried[j] && !m->on[j] && !m->fixed[j] && !may_close(m, j))
            return 0;
    for (int j = 0; j < sw->n; j++)
        m->p[sw->place[j]] = m->tried[j];
    return 1;
}

/* The next choice of `many` out of n; 0: that was the last. */
static int next(int *flip, int many, int n) {
    int i = many - 1;
    while (i >= 0 && flip[i] == n - many + i)
        i--;
    if (i < 0)
        return 0;
    for (flip[i]++; ++i < many;)
        flip[i] = flip[i - 1] + 1;
    return 1;
}

int ph_mode_select(ph_modes *m, const double *x, double h) {
    int n = 0, tried = 0;
    for (int j = 0; j < m->sw->n; j++)
        if (m->sw->unilateral[j] && !m->fixed[j])
            m->asked_of[n++] = j;
    for (int many = 0; many <= n; many++) {
        for (int i = 0; i < many; i++)
            m->flip[i] = i;
        do {
            if (!flipped(m, many))
                continue;
            if (++tried > PH_MOST_TRIED)
                return 0;
            if (complies(m, x, PH_SHORT * h))
                return 1;
        } while (next(m->flip, many, n));
    }
    return 0;
}
