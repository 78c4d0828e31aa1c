/* The way back over one system: rows, energies and values that follow from x, w, u, p and h. */
#include <math.h>
#include <string.h>

#include "reverse_work.h"

/* The bars `bar` (no) of the results of instance i of a group to those of its arguments. */
static void instance_back(ph_reverse *r, const ph_system *s, const ph_group *g, int i, const ph_function *f,
                          double *pb) {
    const int *xi = g->xi + i * g->nx, *yi = g->yi + i * g->ny, *pi = g->pi + i * g->np;
    double *x = r->local, *y = x + g->nx, *p = y + g->ny, *xb = p + g->np, *yb = xb + g->nx, *qb = yb + g->ny;
    for (int j = 0; j < g->nx; j++)
        x[j] = s->x[xi[j]];
    for (int j = 0; j < g->ny; j++)
        y[j] = s->y[yi[j]];
    for (int j = 0; j < g->np; j++)
        p[j] = s->p[pi[j]];
    r->arg[0] = x;
    r->arg[1] = y;
    r->arg[2] = p;
    r->arg[3] = r->bar;
    r->res[0] = xb;
    r->res[1] = yb;
    r->res[2] = qb;
    f->call(f, r->arg, r->res, r->iw, r->work, 0);
    for (int j = 0; j < g->nx; j++)
        r->xb[xi[j]] += xb[j];
    for (int j = 0; j < g->ny; j++)
        r->yb[yi[j]] += yb[j];
    for (int j = 0; j < g->np; j++)
        pb[pi[j]] += qb[j];
}

/* Bars `from` of the results of a group, in their places. */
static void group_back(ph_reverse *r, const ph_system *s, const ph_group *g, const double *from, double *pb) {
    const ph_function *f = &r->kernels[g->kernel];
    for (int i = 0; i < g->n; i++) {
        const int *oi = g->oi + i * g->no;
        int some = 0;
        for (int j = 0; j < g->no; j++) {
            r->bar[j] = s->hp[g->power[j]] * from[oi[j]];
            some |= r->bar[j] != 0.0;
        }
        if (some)
            instance_back(r, s, g, i, f, pb);
    }
}

/* Bars of the energies by component: stored (or its change), and the rate of loss. */
static void energies_back(ph_reverse *r, const ph_system *s, const double *stored, const double *lost,
                          double *pb) {
    for (int l = 0; l < s->plan->ngroup; l++) {
        const ph_group *g = &s->plan->groups[l];
        const ph_function *f = &r->ledgers[g->kernel];
        if (!f->call)
            continue;
        for (int i = 0; i < g->n; i++) {
            r->bar[0] = stored ? stored[g->owner[i]] : 0.0;
            r->bar[1] = lost ? lost[g->owner[i]] : 0.0;
            r->bar[2] = 0.0;
            if (r->bar[0] != 0.0 || r->bar[1] != 0.0)
                instance_back(r, s, g, i, f, pb);
        }
    }
}

void ph_back_clear(ph_reverse *r, const ph_system *s) {
    const ph_plan *p = s->plan;
    ph_clear(r->xb, p->nx + 1 + p->na);
    ph_clear(r->yb, p->nv + p->nz);
    ph_clear(r->rb, p->nrow);
}

void ph_back(ph_reverse *r, ph_system *s, const double *stored, const double *lost, double *pb) {
    const ph_plan *p = s->plan;
    const int n = p->ncondensed;
    double *yb = r->yb, *rb = r->rb;
    int begin = 0;
    if (stored || lost)
        energies_back(r, s, stored, lost, pb);
    for (int i = 0; i < n; i++) {
        rb[p->nrow - n + i] += yb[p->nv + p->nz - n + i];
        yb[p->nv + p->nz - n + i] = 0.0;
    }
    while (begin < p->ngroup && p->groups[begin].stage == 0)
        begin++;
    for (int l = begin; l < p->ngroup; l++)
        group_back(r, s, &p->groups[l], rb, pb);
    for (int l = 0; l < p->nconst; l++)
        yb[p->const_src[l]] += s->constants[l] * rb[p->const_row[l]];
    for (int l = 0; l < begin; l++)
        group_back(r, s, &p->groups[l], yb + p->nv, pb);
}

/* Rows are sums of h^q times kernels and constants, so that their derivatives by h alone are the same sums
 * with q h^(q-1) in place of h^q. */
double ph_back_length(ph_reverse *r, const ph_system *s) {
    const ph_plan *p = s->plan;
    const double derived[3] = {0.0, 1.0, 2.0 * s->hp[1]};
    const ph_point at = {s->x, s->y, s->p, derived, s->work};
    double *z = r->slope, *rows = r->slope + p->nz, bar = r->yb[p->nv - 1];
    ph_clear(r->slope, p->nz + p->nrow);
    for (int l = 0; l < p->ngroup; l++)
        ph_value_of(s->code, &p->groups[l], &at, p->groups[l].stage ? rows : z);
    for (int l = 0; l < p->nconst; l++)
        rows[p->const_row[l]] += p->const_val[l] * derived[p->const_pow[l]] * s->y[p->const_src[l]];
    for (int i = 0; i < p->nz; i++)
        bar += r->yb[p->nv + i] * z[i];
    for (int i = 0; i < p->nrow; i++)
        bar += r->rb[i] * rows[i];
    return bar;
}

#define NOTHING 1e-290 /* bars this small have lost digits: of a measure that does not follow any longer */

/* to = b - A^T l; the largest part of the sums of a column that is left of it, and of those of all columns.
 */
static double rest_of(const ph_system *s, const double *b, const double *l, double *to, double *whole) {
    const ph_plan *p = s->plan;
    double most = 0.0, left = 0.0, size = 0.0;
    for (int j = 0; j < p->nw; j++) {
        double sum = b[j], all = fabs(b[j]);
        for (int e = p->colptr[j]; e < p->colptr[j + 1]; e++) {
            const double part = s->a[e] * l[p->matrix_row[e]];
            sum -= part;
            all += fabs(part);
        }
        to[j] = sum;
        if (fabs(sum) > most * all)
            most = fabs(sum) / all;
        left = fmax(left, fabs(sum));
        size = fmax(size, all);
    }
    *whole = left > NOTHING ? left / size : 0.0;
    return most;
}

#define REFINEMENTS 6  /* of a transposed solve */
#define EXACT 1e-15    /* left of a column: rounding */
#define ACCURATE 1e-10 /* left of all of them: the worst that is taken */

int ph_back_solve(ph_reverse *r, ph_system *s) {
    const int nw = s->plan->nw;
    double *l = r->lambda, most = INFINITY, whole = INFINITY;
    ph_lu_solve_transposed(&s->lu, r->b, l);
    for (int i = 0; i < nw; i++)
        l[i] *= s->scale[i];
    for (int round = 0; round < REFINEMENTS; round++) {
        const double before = most;
        most = rest_of(s, r->b, l, r->rest, &whole);
        if (!(most > EXACT) || !(most < 0.1 * before))
            break;
        ph_lu_solve_transposed(&s->lu, r->rest, r->more);
        for (int i = 0; i < nw; i++)
            l[i] += s->scale[i] * r->more[i];
    }
    return whole <= ACCURATE ? PH_OK : PH_SINGULAR;
}
