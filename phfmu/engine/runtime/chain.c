/* Sensitivity of a step of several internal steps: their linearisations, chained through the states. With
 * R(x, w, u) = 0, outputs y(x, w, u) and x+ = x + U w of an internal step, and X = dx/du, zero at the start,
 *
 *     dw = -A^-1 (R_x X + R_u),   dy = y_x X + y_w dw + y_u,   X+ = X + U dw.
 *
 * The internal steps are solved again from the state at the start of the step; the twin of engine/chain.py.
 */
#include <string.h>

#include "system.h"

/* target += the tangents of one group along dx and chain.dy. */
static void group_along(ph_instance *in, const ph_group *g, const double *dx, double *target) {
    const ph_tangent *tangent = &in->model->tangents[g->kernel];
    const ph_system *s = &in->step;
    const ph_chain *c = &in->chain;
    double *x = c->local, *y = x + g->nx, *p = y + g->ny, *ex = p + g->np, *ey = ex + g->nx,
           *out = ey + g->ny;
    if (!tangent->function)
        return;
    for (int i = 0; i < g->n; i++) {
        for (int j = 0; j < g->nx; j++) {
            x[j] = s->x[g->xi[i * g->nx + j]];
            ex[j] = dx[g->xi[i * g->nx + j]];
        }
        for (int j = 0; j < g->ny; j++) {
            y[j] = s->y[g->yi[i * g->ny + j]];
            ey[j] = c->dy[g->yi[i * g->ny + j]];
        }
        for (int j = 0; j < g->np; j++)
            p[j] = s->p[g->pi[i * g->np + j]];
        c->arg[0] = x;
        c->arg[1] = y;
        c->arg[2] = p;
        c->arg[3] = ex;
        c->arg[4] = ey;
        c->res[0] = out;
        tangent->function(c->arg, c->res, c->iw, c->work, 0);
        for (int j = 0; j < g->no; j++)
            target[g->oi[i * g->no + j]] += s->hp[g->power[j]] * out[j];
    }
}

/* chain.dr = change of all rows along dx (nx+1+na) and chain.dy, whose Z part is filled in; rows at rest: 0.
 */
static void along(ph_instance *in, const double *dx) {
    const ph_system *s = &in->step;
    const ph_plan *p = s->plan;
    const ph_chain *c = &in->chain;
    int i = 0;
    ph_clear(c->dy + p->nv, p->nz);
    ph_clear(c->dr, p->nrow);
    for (; i < p->ngroup && p->groups[i].stage == 0; i++)
        group_along(in, &p->groups[i], dx, c->dy + p->nv);
    for (int l = 0; l < p->nconst; l++)
        c->dr[p->const_row[l]] += s->constants[l] * c->dy[p->const_src[l]];
    for (; i < p->ngroup; i++)
        group_along(in, &p->groups[i], dx, c->dr);
    for (int h = 0; h < p->nhold; h++)
        for (int l = p->hold_ptr[h]; s->rests[h] == PH_RESTS && l < p->hold_ptr[h + 1]; l++)
            c->dr[p->hold_row[l]] = 0.0;
}

/* x (nx+1+na), or a direction of it, to the end of an internal step with the unknowns w, or a direction. */
static void advance(const ph_plan *p, double *x, const double *w, double h) {
    for (int u = 0; u < p->nupdate; u++)
        for (int l = p->update_ptr[u]; l < p->update_ptr[u + 1]; l++)
            for (int i = 0; i < p->update_n[u]; i++)
                x[p->update_x[u] + i] += p->update_c[l] * w[p->update_w[l] + i];
    if (!p->carries)
        return;
    for (int l = 0; l < p->nmean; l++)
        x[p->nx + 1 + p->mean_a[l]] = 0.0;
    for (int l = 0; l < p->nmean; l++) {
        double part = p->mean_c[l] * w[p->mean_w[l]];
        x[p->nx + 1 + p->mean_a[l]] += p->mean_pow[l] < 0 ? part / h : part;
    }
}

/* u (nu*k) = inputs of the last step at the nodes of its part [from, from + length], whatever was set since.
 */
static void old_inputs(ph_instance *in, double from, double length, double *u) {
    const ph_plan *p = in->step.plan;
    double *now = in->u;
    const int held = in->head->held;
    int same = 1;
    for (int i = p->nu; i < p->nu * p->k; i++)
        same &= in->u_old[i] == in->u_old[i - p->nu];
    in->u = in->u_old;
    in->head->held = same;
    ph_resample(in, from, length, u);
    in->u = now;
    in->head->held = held;
}

/* Part i of n, of length h: solved, and its linearisation added to out (nu*nu, the mean outputs). */
static int link(ph_instance *in, int i, int n, double h, double *out) {
    ph_system *s = &in->step;
    const ph_plan *p = s->plan;
    const ph_chain *c = &in->chain;
    const int width = p->nx + 1 + p->na;
    int status;
    c->x[p->nx] = in->x_old[p->nx] + i * h;
    old_inputs(in, (double)i / n, 1.0 / n, s->y + p->nw);
    s->most = in->count[PH_ITERATIONS] + PH_MOST_ITERATIONS;
    status = ph_solve(s, h);
    if (status)
        return status;
    memcpy(s->last, s->y, sizeof(double) * (size_t)p->nw);
    *s->last_h = h;
    ph_eval(s, 1, 1);
    if (p->nw > 0) {
        ph_eval_matrix(s);
        status = ph_newton_factor(s);
        if (status)
            return status;
    }
    for (int j = 0; j < p->nu; j++) {
        double *dx = c->dx + j * width;
        ph_clear(c->dy, p->nv);
        for (int node = 0; node < p->k; node++)
            c->dy[p->nw + node * p->nu + j] = 1.0;
        along(in, dx);
        if (p->nw > 0) {
            memcpy(s->rhs, c->dr, sizeof(double) * (size_t)p->nw);
            ph_solve_refined(s);
        }
        for (int l = 0; l < p->nw; l++)
            c->dy[l] = -s->dw[l];
        along(in, dx);
        for (int m = 0; m < p->nu; m++)
            for (int node = 0; node < p->k; node++)
                out[m * p->nu + j] += p->weights[node] * c->dr[p->nw + node * p->nq + m] / n;
        advance(p, dx, c->dy, h);
    }
    advance(p, c->x, s->last, h);
    return PH_OK;
}

/* Nothing that a later step depends on, or that is counted, changes. */
int ph_chain_sensitivity(ph_instance *in, double *out) {
    ph_system *s = &in->step;
    const ph_plan *p = s->plan;
    const ph_chain *c = &in->chain;
    const int n = in->head->asked, width = p->nx + 1 + p->na;
    const double last_h = *s->last_h;
    long long count[PH_NCOUNT];
    int status = PH_OK;
    memcpy(count, in->count, sizeof(count));
    memcpy(c->last, s->last, sizeof(double) * (size_t)p->nw);
    memcpy(c->x, in->x_old, sizeof(double) * (size_t)width);
    ph_clear(c->dx, width * p->nu);
    ph_clear(out, p->nu * p->nu);
    s->x = c->x;
    for (int i = 0; i < n && status == PH_OK; i++)
        status = link(in, i, n, in->head->step_h / n, out);
    s->x = in->table;
    memcpy(s->last, c->last, sizeof(double) * (size_t)p->nw);
    *s->last_h = last_h;
    memcpy(in->count, count, sizeof(count));
    ph_lu_adopt(&s->lu, s->pivot);
    return status ? PH_NO_SENSITIVITY : PH_OK;
}
