/* The equations of all modes at an instant, and the impulses that a mode asks for, as modes.h
 * has them. */
#include <math.h>
#include <string.h>

#include "work.h"

static void kernel(ph_modes *m, const ph_group *group, const double *x, const double *y, const double *p,
                   double *results) {
    static const double hp[3] = {1.0, 1.0, 1.0};
    const ph_point at = {x, y, p, hp, m->work};
    ph_value_of(m->sw->code, group, &at, results);
}

static void place(ph_modes *m, const double *x, double t) {
    const ph_switches *sw = m->sw;
    memcpy(m->xt, x, sizeof(double) * (size_t)sw->nx);
    m->xt[sw->nx] = t;
}

ph_rates ph_mode_rates(ph_modes *m, const double *x, const double *p, double t) {
    const ph_switches *sw = m->sw;
    const int n = sw->n, nx = sw->nx, na = sw->na;
    ph_rates r;
    place(m, x, t);
    memcpy(m->y, m->a, sizeof(double) * (size_t)na);
    if (sw->nu > 0)
        memcpy(m->y + na, m->u, sizeof(double) * (size_t)sw->nu);
    memset(m->rates, 0, sizeof(double) * (size_t)sw->nresult);
    kernel(m, sw->rates, m->xt, m->y, p, m->rates);
    r.f = m->rates;
    r.fx = r.f + nx;
    r.fa = r.fx + nx * nx;
    r.g = r.fa + nx * na;
    r.gx = r.g + na;
    r.ga = r.gx + na * nx;
    r.c = r.ga + na * na;
    r.cx = r.c + n;
    r.ca = r.cx + n * nx;
    r.gap = r.ca + n * na;
    r.mass = r.gap + n;
    return r;
}

static void gradients(ph_modes *m, const double *x, const double *p, double *out) {
    memset(out, 0, sizeof(double) * (size_t)(m->sw->ncomp * m->sw->nx));
    place(m, x, m->t);
    kernel(m, m->sw->energy, m->xt, m->y, p, out);
}

/* Columns of m->basis: what of the algebraic variables no row g determines; how many. */
static int unbound(ph_modes *m, const ph_rates *r) {
    const int na = m->sw->na;
    double *a = m->matrix;
    int n;
    for (int i = 0; i < na; i++) {
        double largest = 0.0;
        for (int j = 0; j < na; j++) {
            a[i * na + j] = r->ga[j * na + i] * m->sw->scale[j];
            largest = fmax(largest, fabs(a[i * na + j]));
        }
        for (int j = 0; j < na && largest > 0.0; j++)
            a[i * na + j] /= largest;
    }
    n = ph_dense_null(na, a, PH_RANK, m->basis, m->rows, m->columns);
    for (int d = 0; d < n; d++)
        for (int j = 0; j < na; j++)
            m->basis[d * na + j] *= m->sw->scale[j];
    return n;
}

/* Columns of m->moves: L = E^-1 df/da N, of those in m->basis that move states; how many are left. */
static int moving(ph_modes *m, const ph_rates *r, int n) {
    const int na = m->sw->na, nx = m->sw->nx;
    int kept = 0;
    for (int d = 0; d < n; d++) {
        const double *column = m->basis + d * na;
        double *l = m->moves + kept * nx, most = 0.0;
        for (int i = 0; i < nx; i++) {
            l[i] = 0.0;
            for (int j = 0; j < na; j++)
                l[i] += r->fa[j * nx + i] * column[j];
            l[i] /= r->mass[i];
            most = fmax(most, fabs(l[i] / m->sw->size[i]));
        }
        if (most > PH_RANK)
            memmove(m->basis + kept++ * na, column, sizeof(double) * (size_t)na);
    }
    return kept;
}

/* m->kept = N^T dg/dx L, scaled, and the scaling. */
static void stiffness(ph_modes *m, const ph_rates *r, int n) {
    const int na = m->sw->na, nx = m->sw->nx;
    for (int d = 0; d < n; d++)
        for (int e = 0; e < n; e++) {
            double sum = 0.0;
            for (int j = 0; j < nx; j++) {
                double row = 0.0;
                for (int i = 0; i < na; i++)
                    row += m->basis[d * na + i] * r->gx[j * na + i];
                sum += row * m->moves[e * nx + j];
            }
            m->kept[d * n + e] = sum;
        }
    for (int d = 0; d < n; d++) {
        const double diagonal = fabs(m->kept[d * n + d]);
        m->scaling[d] = diagonal > 0.0 ? sqrt(diagonal) : 1.0;
    }
    for (int d = 0; d < n; d++)
        for (int e = 0; e < n; e++)
            m->kept[d * n + e] /= m->scaling[d] * m->scaling[e];
}

int ph_mode_enter(ph_modes *m, const double *x, const double *p, double *to, double *energy) {
    const int nx = m->sw->nx, na = m->sw->na, ncomp = m->sw->ncomp;
    ph_rates r = ph_mode_rates(m, x, p, m->t);
    int n, acts = 0;
    memcpy(to, x, sizeof(double) * (size_t)nx);
    memset(energy, 0, sizeof(double) * (size_t)ncomp);
    n = moving(m, &r, unbound(m, &r));
    if (n == 0)
        return 0;
    stiffness(m, &r, n);
    gradients(m, x, p, m->before);
    for (int pass = 0; pass < PH_PASSES; pass++) {
        r = ph_mode_rates(m, to, p, m->t);
        for (int d = 0; d < n; d++) {
            double c = 0.0;
            for (int i = 0; i < na; i++)
                c += m->basis[d * na + i] * r.g[i];
            m->right[d] = -c / m->scaling[d];
        }
        memcpy(m->matrix, m->kept, sizeof(double) * (size_t)(n * n));
        ph_dense_solve(n, m->matrix, m->right, PH_RANK, m->found, m->rows, m->columns);
        for (int d = 0; d < n; d++) {
            const double impulse = m->found[d] / m->scaling[d];
            acts = acts || impulse != 0.0;
            for (int i = 0; i < nx; i++)
                to[i] += m->moves[d * nx + i] * impulse;
        }
    }
    gradients(m, to, p, m->after);
    for (int c = 0; c < ncomp; c++)
        for (int i = 0; i < nx; i++)
            energy[c] += (m->before[i * ncomp + c] + m->after[i * ncomp + c]) * (to[i] - x[i]) / 2;
    return acts;
}
