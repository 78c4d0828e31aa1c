/* Life of an instance: begin, start values, parameters, what it tells. */
#include <math.h>
#include <string.h>

#include "judge.h"
#include "system.h"

static int plan_fits(const ph_plan *p, const ph_model *model) {
    const ph_plan *step = model->step;
    if (p->nx != step->nx || p->nu != step->nu || p->np != step->np || p->nq != step->nq ||
        p->na != step->na || p->nhold != step->nhold || p->ncomp != step->ncomp ||
        p->nv != p->nw + p->nu * p->k + 1 || p->nrow != p->nw + p->nq * p->k + p->nobs)
        return 0;
    for (int i = 0; i < p->ngroup; i++) {
        const ph_group *g = &p->groups[i];
        const ph_kernel *kernel;
        if (g->kernel < 0 || g->kernel >= model->code->nkernel)
            return 0;
        kernel = &model->code->kernels[g->kernel];
        if (g->nx != kernel->nx || g->ny != kernel->ny || g->np != kernel->np || g->no != kernel->no ||
            g->nj != kernel->nj)
            return 0;
    }
    return 1;
}

static int model_fits(const ph_model *model) {
    return model->stamp == PH_STAMP && model->instant->k == 1 && plan_fits(model->step, model) &&
           plan_fits(model->instant, model);
}

size_t ph_size(const ph_model *model) {
    ph_instance in = {0};
    if (!model_fits(model))
        return 0;
    in.model = model;
    return ph_lay_out(&in, NULL);
}

int ph_init(void *memory, const ph_model *model) {
    ph_instance *in = memory;
    if (!model_fits(model))
        return PH_ABI;
    memset(memory, 0, ph_size(model));
    in->model = model;
    ph_lay_out(in, memory);
    if (in->schur)
        model->code->solver->init(in->schur, model->step);
    for (int i = 0; i < 2; i++) {
        ph_system *s = i ? &in->instant : &in->step;
        s->code = model->code;
        s->x = in->table;
        s->rest = in->rest;
        s->p = in->p;
        s->last_h = &in->head->last_h[i];
        s->count = in->count;
        s->v[0] = 1.0;
        s->hp[1] = NAN;
        s->empty = -1;
    }
    return ph_reset(in);
}

/* Algebraic unknowns of both systems start from the values a. */
void ph_seed(ph_instance *in, const double *a) {
    for (int i = 0; i < 2; i++) {
        ph_system *s = i ? &in->instant : &in->step;
        const ph_plan *p = s->plan;
        for (int l = 0; l < p->nmean; l++)
            if (p->mean_w[l] < p->nw && !p->increments[p->mean_w[l]])
                s->last[p->mean_w[l]] = a[p->mean_a[l]];
    }
    in->head->parts = 0;
    in->head->last_h[0] = 0.0; /* there is no last step to start from */
}

static void copy(double *to, const double *from, int n) {
    if (n > 0)
        memcpy(to, from, sizeof(double) * (size_t)n);
}

/* No pivots are known. */
static void unlearn(ph_system *s) {
    s->lu.ready = s->lu.filled = s->holds = 0;
    if (s->plan->nw > 0)
        s->pivot[0] = -1;
}

void ph_forget(ph_instance *in) {
    for (int i = 0; i < 2; i++) {
        ph_system *s = i ? &in->instant : &in->step;
        ph_clear(s->last, s->plan->nw);
        unlearn(s);
    }
    in->head->kept = 0;
    ph_set_algebraic(in, in->model->a0);
}

int ph_reset(ph_instance *in) {
    const ph_model *m = in->model;
    memset(in->head, 0, in->state_size);
    in->head->token = m->code->token;
    in->head->size = in->state_size;
    unlearn(&in->step);
    unlearn(&in->instant);
    ph_rest_begin(in);
    if (ph_set_parameters(in, m->p0) || ph_set_x(in, m->t0, m->x0) || ph_set_algebraic(in, m->a0) ||
        ph_set_input(in, m->u0))
        return PH_VALUE;
    return PH_OK;
}

int ph_set_algebraic(ph_instance *in, const double *a) {
    if (!ph_finite(a, in->model->step->na))
        return PH_VALUE;
    copy(in->table + in->offset[PH_A], a, in->model->step->na);
    copy(in->table + in->offset[PH_A_END], a, in->model->step->na);
    ph_seed(in, a);
    in->head->dirty = 1;
    return PH_OK;
}

int ph_set_x(ph_instance *in, double t, const double *x) {
    if (!ph_finite(x, in->model->step->nx) || !ph_finite(&t, 1))
        return PH_VALUE;
    int nx = in->model->step->nx;
    copy(in->table, x, nx);
    in->table[nx] = t;
    for (int i = 0; i < nx; i++)
        in->rest[i] = 0.0;
    ph_rest_placed(in);
    in->head->dirty = 1;
    return PH_OK;
}

int ph_set_parameters(ph_instance *in, const double *p) {
    if (!ph_finite(p, in->model->step->np))
        return PH_VALUE;
    copy(in->p, p, in->model->step->np);
    ph_rest_placed(in);
    in->head->parts = 0;
    in->head->dirty = 1;
    return PH_OK;
}

const double *ph_parameters(const ph_instance *in) {
    return in->p;
}

const double *ph_input(const ph_instance *in) {
    return in->u;
}

const double *ph_node_outputs(const ph_instance *in) {
    return in->model->step->k > 1 ? in->y_node : in->table + in->offset[PH_Y_STEP];
}

int ph_continue(ph_instance *in, const ph_instance *from) {
    const ph_plan *p = in->model->step, *q = from->model->step;
    const int length = in->offset[PH_OBSERVABLES], together = in->table[p->nx] == from->table[p->nx];
    if (length != from->offset[PH_OBSERVABLES] || p->nx != q->nx || p->np != q->np || p->nu != q->nu ||
        p->ncomp != q->ncomp || p->nq != q->nq || (p->nu > 0 && !from->head->held))
        return PH_ARGUMENT;
    copy(in->table, from->table, length);
    copy(in->rest, from->rest, p->nx);
    copy(in->table_rest, from->table_rest, p->nq + 3 * p->ncomp);
    for (int c = 0; c < p->ncomp && p->schur && q->schur; c++)
        in->reach[c] = ph_most(in->reach[c], from->reach[c]);
    copy(in->p, from->p, p->np);
    if (!together) /* its own last step is no longer the one before the next */
        ph_seed(in, in->table + in->offset[PH_A]);
    in->head->parts = 0;
    in->head->kept = 0;
    in->head->dirty = 1;
    ph_rest_placed(in);
    ph_rest_continue(in, from);
    return ph_set_input(in, from->u);
}

const double *ph_signals(const ph_instance *in) {
    return in->table;
}

const double *ph_ledger(const ph_instance *in, int row) {
    return row >= 0 && row < PH_NROW ? in->row[row] : NULL;
}

const double *ph_unknowns(const ph_instance *in) {
    return in->step.last;
}

const ph_rest_change *ph_rest_changes(const ph_instance *in, int *n) {
    *n = in->head->changes;
    return in->changes;
}

const long long *ph_counts(const ph_instance *in) {
    return in->count;
}

const ph_report *ph_last_report(const ph_instance *in) {
    return &in->report;
}

#define TEXT(name, text) text,
const char *ph_status_text(int status) {
    static const char *const texts[] = {PH_STATUS_LIST(TEXT)};
    return status >= 0 && status < PH_NSTATUS ? texts[status] : "unknown status";
}
