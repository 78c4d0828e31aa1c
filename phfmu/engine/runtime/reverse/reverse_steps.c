/* The way back over the parts of steps of a tape, and from values at an instant. */
#include <string.h>

#include "reverse_work.h"

static ph_bars bars_of(const ph_reverse *r, int measure) {
    const ph_plan *p = r->in->model->step;
    double *at = r->bars + (size_t)measure * (size_t)ph_reverse_width(r->in->model);
    ph_bars b;
    b.x = at;
    b.p = b.x + p->nx + 1;
    b.u = b.p + p->np;
    b.pairs = b.u + p->nu;
    b.lost = b.pairs + p->nq;
    b.h = b.lost + p->ncomp;
    return b;
}

int ph_reverse_width(const ph_model *model) {
    const ph_plan *p = model->step;
    return p->nx + 1 + p->np + p->nu + p->nq + p->ncomp + 1;
}

/* The matrix of the present part and its factor. */
static int factor(ph_system *s) {
    ph_eval_matrix(s);
    return ph_newton_factor(s);
}

/* The part of a tape's row becomes the point of the system of steps; its equations, by the factor of the
 * Schur stepper where that serves. Bars of what a part tells, and of its length, are taken from the values of
 * the rows. */
static int place(ph_reverse *r, const double *row, int late, int moves) {
    ph_instance *in = r->in;
    ph_system *s = &in->step;
    const ph_plan *p = s->plan;
    const double *w = row + 2 + p->nx;
    memcpy(r->x, row + 2, sizeof(double) * (size_t)p->nx);
    r->x[p->nx] = row[0];
    r->h = row[1];
    memcpy(s->y, w, sizeof(double) * (size_t)(p->nw + p->nu * p->k));
    r->quick = r->schur && !moves && in->planned && r->fast->begin(r->schur, s, row[1]) == PH_OK;
    if (r->quick && !late)
        return PH_OK;
    ph_eval_h(s, row[1]);
    ph_eval(s, !r->quick, late);
    return p->nw == 0 || r->quick ? PH_OK : factor(s);
}

/* The equations of a part for which the factor of the Schur stepper has not served. */
static int place_again(ph_reverse *r) {
    ph_system *s = &r->in->step;
    r->quick = 0;
    ph_eval_h(s, r->h);
    ph_eval(s, 1, 1);
    return factor(s);
}

/* Bars of what the part tells: its share of the means a and y_step of the row, energies through pairs,
 * losses. To Y, p, x, and through Y to the right-hand side of the solve. */
static void told_back(ph_reverse *r, ph_system *s, const ph_bars *at, const double *bar, double part) {
    const ph_plan *p = s->plan;
    const double h = s->hp[1];
    for (int l = 0; bar && l < p->nmean; l++) {
        const double own = part * p->mean_c[l] * bar[p->nx + p->mean_a[l]];
        r->yb[p->mean_w[l]] += p->mean_pow[l] < 0 ? own / h : own;
    }
    for (int i = 0; i < p->k; i++)
        for (int j = 0; j < p->nq; j++) {
            const int row = p->nw + i * p->nq + j, source = p->pair_src[i * p->nq + j];
            const double mean = bar ? part * bar[p->nx + p->na + j] : 0.0;
            r->rb[row] += p->weights[i] * (mean + h * s->y[source] * at->pairs[j]);
            r->yb[source] += h * p->weights[i] * s->r[row] * at->pairs[j];
        }
    for (int l = 0; l < p->nwork; l++)
        r->rb[p->work_row[l]] += at->pairs[p->work_pair[l]];
    for (int c = 0; c < p->ncomp; c++)
        r->lost[c] = h * at->lost[c];
    ph_back(r, s, NULL, r->lost, at->p);
}

/* The bar of h in what the part tells, behind told_back. */
static double told_length(ph_reverse *r, ph_system *s, const ph_bars *at, const double *bar, double part) {
    const ph_plan *p = s->plan;
    const double h = s->hp[1];
    ph_instance *in = r->in;
    double found = ph_back_length(r, s);
    for (int l = 0; bar && l < p->nmean; l++)
        if (p->mean_pow[l] < 0)
            found -= part * p->mean_c[l] * bar[p->nx + p->mean_a[l]] * s->y[p->mean_w[l]] / (h * h);
    for (int i = 0; i < p->k; i++)
        for (int j = 0; j < p->nq; j++)
            found +=
                p->weights[i] * s->r[p->nw + i * p->nq + j] * s->y[p->pair_src[i * p->nq + j]] * at->pairs[j];
    ph_eval_ledger(s, in->stored, in->moved, in->lost, in->numerical);
    for (int c = 0; c < p->ncomp; c++)
        found += in->lost[c] * at->lost[c];
    return found;
}

/* The bars of x and u that a pass has found. */
static void gather(const ph_reverse *r, const ph_plan *p, const ph_bars *at) {
    for (int i = 0; i <= p->nx; i++)
        at->x[i] += r->xb[i];
    for (int i = 0; i < p->k; i++)
        for (int j = 0; j < p->nu; j++)
            at->u[j] += r->yb[p->nw + i * p->nu + j];
}

/* The bars of the unknowns, b, go through the solution of the equations to those of x, u and p. */
static int unknowns_back(ph_reverse *r, ph_system *s, const ph_bars *at) {
    const ph_plan *p = s->plan;
    if (p->nw == 0)
        return PH_OK;
    if (ph_back_solve(r, s))
        return PH_SINGULAR;
    ph_back_clear(r, s);
    for (int i = 0; i < p->nw; i++)
        r->rb[i] = -r->lambda[i];
    ph_back(r, s, NULL, NULL, at->p);
    gather(r, p, at);
    return PH_OK;
}

/* One measure over one part; bar: of its row, or NULL. *length: NULL, or the bar of the part's length. */
static int part_back(ph_reverse *r, int measure, const double *bar, double part, int tells, double *length) {
    const ph_bars bars = bars_of(r, measure), *at = &bars;
    ph_system *s = &r->in->step;
    const ph_plan *p = s->plan;
    ph_clear(r->b, p->nw);
    for (int u = 0; u < p->nupdate; u++)
        for (int l = p->update_ptr[u]; l < p->update_ptr[u + 1]; l++)
            for (int i = 0; i < p->update_n[u]; i++)
                r->b[p->update_w[l] + i] += p->update_c[l] * at->x[p->update_x[u] + i];
    if (tells) {
        ph_back_clear(r, s);
        told_back(r, s, at, bar, part);
        for (int i = 0; i < p->nw; i++)
            r->b[i] += r->yb[i];
        gather(r, p, at);
        if (length)
            *length = told_length(r, s, at, bar, part);
    }
    if (r->quick && r->fast->back(r->schur, measure, r->b, at->x, at->u, at->p) == PH_OK) {
        r->by_schur++;
        return PH_OK;
    }
    if ((r->quick && place_again(r)) || unknowns_back(r, s, at))
        return PH_SINGULAR;
    if (length && p->nw > 0)
        *length += ph_back_length(r, s);
    return PH_OK;
}

/* The way back over a part of a step that moves: it begins at `from` of the step's start and is `share` of
 * its length, so that it moves with both. */
static int moving_back(ph_reverse *r, int measure, const double *bar, double share, double from, int tells) {
    const ph_bars bars = bars_of(r, measure), *at = &bars;
    double *t = at->x + r->in->model->step->nx, before = *t, length = 0.0;
    if (part_back(r, measure, bar, share, tells, &length))
        return PH_SINGULAR;
    *at->h += share * length + from * (*t - before);
    return PH_OK;
}

static int some(const double *values, int n) {
    for (int i = 0; i < n; i++)
        if (values[i] != 0.0)
            return 1;
    return 0;
}

int ph_reverse_steps(ph_reverse *r, const ph_parts *parts, const ph_row_bars *told, double *at) {
    ph_instance *in = r->in;
    ph_system *s = &in->step;
    const ph_plan *p = s->plan;
    const int own = p->nx + p->na + 2 * p->nq + p->ncomp, width = ph_tape_width(in->model);
    int next = told->n - 1, last = -1, status = PH_OK;
    ph_newton_bare(s, p->nhold > 0 && !p->vanishing);
    s->x = r->x;
    for (int k = parts->n - 1; k >= 0 && status == PH_OK; k--) {
        const double *row = parts->rows + (size_t)k * (size_t)width, *bar;
        int tells = 0;
        if (parts->row[k] != last) {
            last = parts->row[k];
            while (next >= 0 && told->row[next] > last)
                next--;
        }
        bar = next >= 0 && told->row[next] == last ? told->bar + (size_t)next * (size_t)(r->n * own) : NULL;
        for (int c = 0; c < r->n; c++) {
            const ph_bars b = bars_of(r, c);
            const double *mine = bar ? bar + c * own : NULL;
            const int ends = k == parts->n - 1 || parts->row[k + 1] != last;
            if (mine && ends) {
                for (int i = 0; i < p->nx; i++)
                    b.x[i] += mine[i];
                for (int i = 0; i < p->nq + p->ncomp; i++)
                    b.pairs[i] += mine[p->nx + p->na + p->nq + i];
            }
            tells |= (mine && some(mine + p->nx, p->na + p->nq)) || some(b.pairs, p->nq + p->ncomp);
        }
        status = place(r, row, tells, parts->moves);
        for (int c = 0; c < r->n && status == PH_OK; c++) {
            const double *mine = bar ? bar + c * own : NULL, share = parts->part[k];
            const double from = (row[0] - parts->rows[0]) * share / row[1];
            status = parts->moves ? moving_back(r, c, mine, share, from, tells)
                                  : part_back(r, c, mine, share, tells, NULL);
        }
        if (status)
            *at = row[0];
    }
    s->x = in->table;
    return status;
}

int ph_reverse_instant(ph_reverse *r, const double *bar) {
    ph_instance *in = r->in;
    ph_system *s = &in->instant;
    const ph_plan *p = s->plan;
    const int own = p->na + p->nq + p->nobs + p->ncomp;
    int status = ph_refresh(in);
    if (status)
        return status;
    memcpy(s->y, s->last, sizeof(double) * (size_t)p->nw);
    ph_inputs_at(in, in->head->theta, s->y + p->nw);
    ph_eval_h(s, 1.0);
    ph_eval(s, 1, 1);
    if (p->nw > 0) {
        ph_eval_matrix(s);
        status = ph_newton_factor(s);
    }
    for (int c = 0; c < r->n && status == PH_OK; c++) {
        const ph_bars at = bars_of(r, c);
        const double *mine = bar + c * own;
        if (!some(mine, own))
            continue;
        ph_back_clear(r, s);
        for (int l = 0; l < p->nmean; l++)
            r->yb[p->mean_w[l]] += p->mean_c[l] * mine[p->mean_a[l]];
        memcpy(r->rb + p->nw, mine + p->na, sizeof(double) * (size_t)(p->nq + p->nobs));
        ph_back(r, s, mine + p->na + p->nq + p->nobs, NULL, at.p);
        memcpy(r->b, r->yb, sizeof(double) * (size_t)p->nw);
        gather(r, p, &at);
        status = unknowns_back(r, s, &at);
    }
    ph_lu_adopt(&s->lu, s->pivot);
    return status;
}

static int larger(int a, int b) {
    return a > b ? a : b;
}

static void lay_out(ph_reverse *r, ph_pool *pool) {
    const ph_model *m = r->in->model;
    const ph_plan *p = m->step, *q = m->instant;
    int local = 0, work = 0, iw = 0, arg = 4, res = 3, no = 3;
    for (int i = 0; i < p->ngroup + q->ngroup; i++) {
        const ph_group *g = i < p->ngroup ? &p->groups[i] : &q->groups[i - p->ngroup];
        local = larger(local, 2 * (g->nx + g->ny + g->np));
        no = larger(no, g->no);
        for (int l = 0; l < 2; l++) {
            const ph_function *f = l ? &r->ledgers[g->kernel] : &r->kernels[g->kernel];
            work = larger(work, f->w);
            iw = larger(iw, f->iw);
            arg = larger(arg, f->arg);
            res = larger(res, f->res);
        }
    }
    r->bars = ph_take_doubles(pool, r->n * ph_reverse_width(m));
    r->x = ph_take_doubles(pool, p->nx + 1 + p->na);
    r->xb = ph_take_doubles(pool, p->nx + 1 + p->na);
    r->yb = ph_take_doubles(pool, larger(p->nv + p->nz, q->nv + q->nz));
    r->rb = ph_take_doubles(pool, larger(p->nrow, q->nrow));
    r->b = ph_take_doubles(pool, larger(p->nw, q->nw));
    r->lambda = ph_take_doubles(pool, larger(p->nw, q->nw));
    r->rest = ph_take_doubles(pool, larger(p->nw, q->nw));
    r->more = ph_take_doubles(pool, larger(p->nw, q->nw));
    r->lost = ph_take_doubles(pool, p->ncomp);
    r->slope = ph_take_doubles(pool, larger(p->nz + p->nrow, q->nz + q->nrow));
    r->bar = ph_take_doubles(pool, no);
    r->local = ph_take_doubles(pool, local);
    r->work = ph_take_doubles(pool, work);
    r->iw = ph_take_ints(pool, iw);
    r->arg = ph_take(pool, sizeof(double *) * (size_t)arg);
    r->res = ph_take(pool, sizeof(double *) * (size_t)res);
    r->schur = r->fast ? ph_take(pool, r->fast->size(p, r->n)) : NULL;
}

static ph_reverse begun(const ph_instance *in, const ph_backwards *functions, int n) {
    ph_reverse r = {
        .in = (ph_instance *)(uintptr_t)in, .kernels = functions->kernels, .ledgers = functions->ledgers};
    r.n = n;
    r.fast = functions->schur && functions->schur->size ? functions->schur : NULL;
    return r;
}

size_t ph_reverse_size(const ph_instance *in, const ph_backwards *functions, int n) {
    ph_reverse r = begun(in, functions, n);
    ph_pool pool = {0};
    ph_take(&pool, sizeof(r));
    lay_out(&r, &pool);
    return pool.used;
}

ph_reverse *ph_reverse_init(void *memory, ph_instance *in, const ph_backwards *functions, int n) {
    ph_reverse *r = memory;
    ph_pool pool = {memory, 0};
    memset(memory, 0, ph_reverse_size(in, functions, n));
    *r = begun(in, functions, n);
    ph_take(&pool, sizeof(*r));
    lay_out(r, &pool);
    if (r->fast)
        r->fast->init(r->schur, in->model->step, n);
    return r;
}

double *ph_reverse_bars(ph_reverse *r) {
    return r->bars;
}

int ph_reverse_by_schur(const ph_reverse *r) {
    return r->by_schur;
}
