/* Derivatives of a step and of end values. Of a step in several parts: the linearisations of its internal
 * steps and substeps, chained through the states. With R(x, w, u) = 0, outputs y(x, w, u) and x+ = x + U w of
 * one of them, X the direction of its old states and V that of its inputs,
 *
 *     dw = -A^-1 (R_x X + R_u V),   dy = y_x X + y_w dw + y_u V,   X+ = X + U dw.
 *
 * Several are solved again, from the state and the unknowns at the start of the step; the twin of
 * engine/reference/chain.py.
 */
#include <string.h>

#include "system.h"

enum { RESIDUALS, OUTPUTS }; /* which rows are wanted */

/* Entries of `from` at n places into `to`; whether one of them is not zero. */
static int gathered(double *to, const double *from, const int *place, int n) {
    int moves = 0;
    for (int j = 0; j < n; j++) {
        to[j] = from[place[j]];
        moves |= to[j] != 0.0;
    }
    return moves;
}

/* target += what a function of the kernel tells at the arguments that chain.arg has. */
static void add_along(const ph_chain *c, const ph_system *s, const ph_group *g, int i, const ph_function *f,
                      double *target) {
    f->call(f, c->arg, c->res, c->iw, c->work, 0);
    for (int j = 0; j < g->no; j++)
        target[g->oi[i * g->no + j]] += s->hp[g->power[j]] * c->res[0][j];
}

/* target += the tangents of one group along dx, chain.dy and chain.dp; an instance along which nothing moves
 * has none. */
static void group_along(ph_instance *in, const ph_system *s, const ph_group *g, const double *dx,
                        double *target) {
    const ph_chain *c = &in->chain;
    const ph_function *tangent = &in->model->tangents[g->kernel];
    const ph_function *slope = c->dp ? &in->model->slopes[g->kernel] : tangent;
    double *x = c->local, *y = x + g->nx, *p = y + g->ny, *ex = p + g->np, *ey = ex + g->nx, *ep = ey + g->ny;
    if (!tangent->call && !slope->call)
        return;
    for (int i = 0; i < g->n; i++) {
        const int *xi = g->xi + i * g->nx, *yi = g->yi + i * g->ny, *pi = g->pi + i * g->np;
        int moves = gathered(ex, dx, xi, g->nx), by_parameters = 0;
        moves |= gathered(ey, c->dy, yi, g->ny);
        if (c->dp)
            by_parameters = gathered(ep, c->dp, pi, g->np) && slope->call;
        if (!moves && !by_parameters)
            continue;
        gathered(x, s->x, xi, g->nx);
        gathered(y, s->y, yi, g->ny);
        gathered(p, s->p, pi, g->np);
        c->arg[0] = x;
        c->arg[1] = y;
        c->arg[2] = p;
        c->res[0] = ep + g->np;
        c->arg[3] = ep;
        if (by_parameters)
            add_along(c, s, g, i, slope, target);
        c->arg[3] = ex;
        c->arg[4] = ey;
        if (moves && tangent->call)
            add_along(c, s, g, i, tangent, target);
    }
}

/* chain.dr = change of the wanted rows of s along dx (nx+1+na) and chain.dy, whose Z part is filled in; rows
 * at rest: 0. Others are not all there. */
static void along(ph_instance *in, const ph_system *s, const double *dx, int wanted) {
    const ph_plan *p = s->plan;
    const ph_chain *c = &in->chain;
    int i = 0;
    ph_clear(c->dy + p->nv, p->nz);
    ph_clear(c->dr, p->nrow);
    for (; i < p->ngroup && p->groups[i].stage == 0; i++)
        group_along(in, s, &p->groups[i], dx, c->dy + p->nv);
    for (int l = 0; l < p->nconst; l++)
        c->dr[p->const_row[l]] += s->constants[l] * c->dy[p->const_src[l]];
    for (; i < p->ngroup; i++)
        if (wanted == RESIDUALS ? !p->groups[i].late : p->groups[i].reports)
            group_along(in, s, &p->groups[i], dx, c->dr);
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

/* Outputs of chain.dr along dx and the inputs in chain.dy, with the unknowns, which go into chain.dy,
 * following. */
static void follow(ph_instance *in, ph_system *s, const double *dx) {
    const ph_plan *p = s->plan;
    const ph_chain *c = &in->chain;
    if (p->nw > 0) {
        along(in, s, dx, RESIDUALS);
        memcpy(s->rhs, c->dr, sizeof(double) * (size_t)p->nw);
        ph_solve_refined(s);
    }
    for (int l = 0; l < p->nw; l++)
        c->dy[l] = -s->dw[l];
    along(in, s, dx, OUTPUTS);
}

/* The linearisation at the Y of the system. */
static int linearise(ph_system *s) {
    ph_eval(s, 1, 1);
    if (s->plan->nw == 0)
        return PH_OK;
    ph_eval_matrix(s);
    return ph_newton_factor(s);
}

/* The part [from, from + length] of the step: solved again, unless it is the whole step. */
static int solve_again(ph_instance *in, double from, double length, double h) {
    ph_system *s = &in->step;
    const int nw = s->plan->nw;
    int status;
    in->chain.x[s->plan->nx] = in->x_old[s->plan->nx] + in->head->step_h * from;
    old_inputs(in, from, length, s->y + nw);
    if (length == 1.0) {
        memcpy(s->y, s->last, sizeof(double) * (size_t)nw);
        ph_eval_h(s, h);
        return PH_OK;
    }
    s->most = in->count[PH_ITERATIONS] + PH_MOST_ITERATIONS;
    status = ph_solve(s, h);
    if (status)
        return status;
    memcpy(s->last, s->y, sizeof(double) * (size_t)nw);
    *s->last_h = h;
    return PH_OK;
}

/* a (na) += part times the means of the algebraic variables, or a direction of them, of the unknowns w. */
static void add_means(const ph_plan *p, double *a, const double *w, double h, double part) {
    for (int l = 0; l < p->nmean; l++)
        a[p->mean_a[l]] += part * p->mean_c[l] * w[p->mean_w[l]] / (p->mean_pow[l] < 0 ? h : 1.0);
}

/* That part: what it adds to d->dy and d->da, and d->dx at its end. */
static int link(ph_instance *in, double from, double length, const ph_directions *d) {
    ph_system *s = &in->step;
    const ph_plan *p = s->plan;
    ph_chain *c = &in->chain;
    const int k = p->k, nu = p->nu, width = p->nx + 1 + p->na;
    const double h = in->head->step_h * length;
    int status = solve_again(in, from, length, h);
    if (status == PH_OK)
        status = linearise(s);
    if (status)
        return status;
    for (int m = 0; m < k; m++) {
        ph_basis(in, from + length * p->nodes[m]);
        memcpy(c->basis + m * k, in->basis, sizeof(double) * (size_t)k);
    }
    for (int j = 0; j < d->n; j++) {
        const double *du = d->du + j * k * nu;
        double *dx = d->dx + j * width, *dy = d->dy + j * k * nu;
        c->dp = d->dp ? d->dp + j * p->np : NULL;
        ph_clear(c->dy, p->nv);
        for (int m = 0; m < k; m++)
            for (int i = 0; i < k; i++)
                for (int l = 0; l < nu; l++)
                    c->dy[p->nw + m * nu + l] += c->basis[m * k + i] * du[i * nu + l];
        follow(in, s, dx);
        for (int m = 0; m < k; m++)
            for (int i = 0; i < k; i++)
                for (int l = 0; l < nu; l++)
                    dy[i * nu + l] += length * p->weights[m] / p->weights[i] * c->basis[m * k + i] *
                                      c->dr[p->nw + m * p->nq + l];
        advance(p, dx, c->dy, h);
        if (d->da)
            add_means(p, d->da + j * p->na, c->dy, h, length);
    }
    c->dp = NULL;
    advance(p, c->x, s->last, h);
    return PH_OK;
}

/* Nothing that a later step depends on, or that is counted, changes. */
int ph_step_along(ph_instance *in, const ph_directions *d) {
    ph_system *s = &in->step;
    const ph_plan *p = s->plan;
    const ph_chain *c = &in->chain;
    const int n = in->head->parts == 1 ? 1 : in->head->asked;
    const double last_h = *s->last_h;
    long long count[PH_NCOUNT];
    int status = PH_OK;
    if (!c->x || (d->dp && !in->model->slopes) || !ph_solves(in))
        return PH_NO_SENSITIVITY;
    memcpy(count, in->count, sizeof(count));
    memcpy(c->last, s->last, sizeof(double) * (size_t)p->nw);
    memcpy(c->x, in->x_old, sizeof(double) * (size_t)(p->nx + 1 + p->na));
    ph_clear(d->dy, d->n * p->k * p->nu);
    if (d->da)
        ph_clear(d->da, d->n * p->na);
    if (ph_solves(in) > 1) { /* from where it was solved: to the same solution */
        memcpy(s->last, in->first, sizeof(double) * (size_t)p->nw);
        *s->last_h = in->head->first_h;
    }
    s->x = c->x;
    for (int i = 0; i < n; i++)
        for (int at = 0, end; at < PH_SMALLEST && status == PH_OK; at = end) {
            end = ph_part_end(in, i, at);
            status = link(in, (i + (double)at / PH_SMALLEST) / n, (double)(end - at) / PH_SMALLEST / n, d);
        }
    s->x = in->table;
    memcpy(s->last, c->last, sizeof(double) * (size_t)p->nw);
    *s->last_h = last_h;
    memcpy(in->count, count, sizeof(count));
    ph_lu_adopt(&s->lu, s->pivot);
    return status ? PH_NO_SENSITIVITY : PH_OK;
}

int ph_end_along(ph_instance *in, const ph_directions *d) {
    ph_system *s = &in->instant;
    const ph_plan *p = s->plan;
    ph_chain *c = &in->chain;
    const int k = in->model->step->k, nu = p->nu, width = p->nx + 1 + p->na;
    int status = c->x && (!d->dp || in->model->slopes) ? ph_refresh(in) : PH_NO_SENSITIVITY;
    if (status)
        return status;
    memcpy(s->y, s->last, sizeof(double) * (size_t)p->nw);
    ph_inputs_at(in, in->head->theta, s->y + p->nw);
    ph_eval_h(s, 1.0);
    status = linearise(s);
    ph_basis(in, 1.0);
    for (int j = 0; j < d->n && status == PH_OK; j++) {
        c->dp = d->dp ? d->dp + j * p->np : NULL;
        ph_clear(c->dy, p->nv);
        for (int i = 0; i < k; i++)
            for (int l = 0; l < nu; l++)
                c->dy[p->nw + l] += in->basis[i] * d->du[(j * k + i) * nu + l];
        follow(in, s, d->dx + j * width);
        memcpy(d->dy + j * nu, c->dr + p->nw, sizeof(double) * (size_t)nu);
        if (d->dobs && p->nobs > 0)
            memcpy(d->dobs + j * p->nobs, c->dr + p->nw + p->nq, sizeof(double) * (size_t)p->nobs);
        if (d->da) {
            ph_clear(d->da + j * p->na, p->na);
            add_means(p, d->da + j * p->na, c->dy, 1.0, 1.0);
        }
    }
    c->dp = NULL;
    ph_lu_adopt(&s->lu, s->pivot);
    return status;
}

/* Every input at all nodes together, outputs as means. */
static int chain_sensitivity(ph_instance *in, double *out) {
    const ph_plan *p = in->step.plan;
    const ph_chain *c = &in->chain;
    const int k = p->k, nu = p->nu;
    const ph_directions d = {.n = nu, .du = c->du, .dx = c->dx, .dy = c->dy_node};
    int status;
    ph_clear(c->du, nu * k * nu);
    for (int j = 0; j < nu; j++)
        for (int i = 0; i < k; i++)
            c->du[(j * k + i) * nu + j] = 1.0;
    ph_clear(c->dx, (p->nx + 1 + p->na) * nu);
    status = ph_step_along(in, &d);
    ph_clear(out, nu * nu);
    for (int j = 0; j < nu; j++)
        for (int i = 0; i < k; i++)
            for (int m = 0; m < nu; m++)
                out[m * nu + j] += p->weights[i] * d.dy[(j * k + i) * nu + m];
    return status;
}

/* S = D - C A^-1 B at the Y of the system, by the implicit function theorem. */
static int sensitivity(ph_system *s, double *out) {
    const ph_plan *p = s->plan;
    const int nu = p->nu, nw = p->nw;
    const double *value = s->blocks;
    ph_eval(s, 1, 1);
    ph_eval_derivatives(s, s->blocks);
    if (nw > 0) {
        int status;
        ph_eval_matrix(s);
        status = ph_newton_factor(s);
        if (status)
            return status;
    }
    for (int j = 0; j < nu; j++) {
        for (int i = 0; i < nu; i++)
            out[i * nu + j] = 0.0;
        for (int i = 0; i < nw; i++)
            s->rhs[i] = 0.0;
        for (int e = 0; e < p->nderivative; e++)
            if (p->derivative_col[e] == nw + j) {
                if (p->derivative_row[e] < nw)
                    s->rhs[p->derivative_row[e]] += value[e];
                else
                    out[(p->derivative_row[e] - nw) * nu + j] += value[e];
            }
        if (nw == 0)
            continue;
        ph_solve_refined(s);
        for (int e = 0; e < p->nderivative; e++)
            if (p->derivative_row[e] >= nw && p->derivative_col[e] < nw)
                out[(p->derivative_row[e] - nw) * nu + j] -= value[e] * s->dw[p->derivative_col[e]];
    }
    return PH_OK;
}

int ph_sensitivity(ph_instance *in, double *out) {
    ph_system *s = &in->step;
    const ph_plan *p = s->plan;
    int status;
    if (in->head->parts != 1)
        return ph_solves(in) && in->chain.x ? chain_sensitivity(in, out) : PH_NO_SENSITIVITY;
    memcpy(s->y, s->last, sizeof(double) * (size_t)p->nw);
    if (p->nu > 0)
        memcpy(s->y + p->nw, in->u_old, sizeof(double) * (size_t)(p->nu * p->k));
    ph_eval_h(s, in->head->step_h);
    s->x = in->x_old;
    status = sensitivity(s, out);
    s->x = in->table;
    /* Asking must not change later steps: back to the pivots of the last step. */
    ph_lu_adopt(&s->lu, s->pivot);
    return status;
}

int ph_sensitivity_end(ph_instance *in, double *out) {
    ph_system *s = &in->instant;
    int status = ph_refresh(in);
    if (status)
        return status;
    memcpy(s->y, s->last, sizeof(double) * (size_t)s->plan->nw);
    ph_inputs_at(in, in->head->theta, s->y + s->plan->nw);
    ph_eval_h(s, 1.0);
    status = sensitivity(s, out);
    ph_lu_adopt(&s->lu, s->pivot);
    return status;
}
