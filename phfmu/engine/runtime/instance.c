/* Memory of an instance: layout, start values, inputs, parameters, save and restore. */
#include <math.h>
#include <string.h>

#include "system.h"

/* Hands out the parts of one block; without a block it only counts. */
typedef struct block {
    char *base;
    size_t used;
} block;

static void *take(block *b, size_t bytes) {
    size_t at = b->used;
    b->used += (bytes + 15) / 16 * 16;
    return b->base ? b->base + at : NULL;
}

static double *doubles(block *b, int n) {
    return take(b, sizeof(double) * (size_t)n);
}
static int *ints(block *b, int n) {
    return take(b, sizeof(int) * (size_t)n);
}

void ph_layout(const ph_model *model, int *offset) {
    const ph_plan *p = model->step;
    const int length[PH_NBLOCK] = {
        p->nx,   1, p->na, p->nq, p->nq, p->ncomp, p->ncomp, p->ncomp, p->na, p->nq, model->instant->nobs,
        p->ncomp};
    offset[0] = 0;
    for (int i = 0; i < PH_NBLOCK; i++)
        offset[i + 1] = offset[i] + length[i];
}

static void lay_state(ph_instance *in, block *b) {
    const ph_plan *p = in->model->step;
    const int length[PH_NROW] = {p->ncomp, p->ncomp, p->ncomp, p->ncomp, p->ncomp, p->nq};
    in->head = take(b, sizeof(ph_head));
    in->table = doubles(b, in->offset[PH_NBLOCK]);
    in->rest = doubles(b, p->nx);
    in->table_rest = doubles(b, p->nq + 3 * p->ncomp);
    for (int i = 0; i < PH_NROW; i++)
        in->row[i] = doubles(b, length[i]);
    in->u = doubles(b, p->nu * p->k);
    in->p = doubles(b, p->np);
    in->x_old = doubles(b, p->nx + 1 + p->na);
    in->u_old = doubles(b, p->nu * p->k);
    in->first = doubles(b, p->nw);
    in->y_node = doubles(b, p->k > 1 ? p->nq * p->k : 0);
    in->changes = take(b, p->nhold > 0 ? sizeof(ph_rest_change) * PH_KEPT_CHANGES : 0);
    in->step.last = doubles(b, p->nw);
    in->step.pivot = ints(b, p->nw);
    in->step.rests = in->instant.rests = ints(b, p->nhold);
    in->instant.last = doubles(b, in->model->instant->nw);
    in->instant.pivot = ints(b, in->model->instant->nw);
}

static void lay_lu(ph_lu *lu, const ph_plan *p, block *b) {
    lu->n = p->nw;
    lu->nnz = p->nnz;
    lu->capacity = p->lucap;
    lu->colptr = p->colptr;
    lu->rowind = p->matrix_row;
    lu->order = p->order;
    lu->prefer = p->pivot_row;
    lu->pivot = ints(b, lu->n);
    lu->where = ints(b, lu->n);
    lu->start = ints(b, lu->n + 1);
    lu->lower = ints(b, lu->n);
    lu->index = ints(b, lu->capacity);
    lu->value = doubles(b, lu->capacity);
    lu->inverse = doubles(b, lu->n);
    lu->place = ints(b, lu->nnz);
    lu->work = doubles(b, lu->n);
    lu->mark = ints(b, lu->n);
    lu->stack = ints(b, lu->n);
    lu->child = ints(b, lu->n);
}

static void lay_system(ph_system *s, const ph_plan *p, block *b) {
    s->plan = p;
    s->y = doubles(b, p->nv + p->nz);
    s->r = doubles(b, p->nrow);
    s->v = doubles(b, p->nslot);
    s->a = doubles(b, p->nnz);
    s->factored = doubles(b, p->nnz);
    s->scaled = doubles(b, p->nnz);
    s->scale = doubles(b, p->nw);
    s->rhs = doubles(b, p->nw);
    s->dw = doubles(b, p->nw);
    s->base = doubles(b, p->nw);
    s->products = doubles(b, p->varying_ptr[p->nvarying]);
    s->fixed = doubles(b, p->nnz);
    s->derivatives = doubles(b, p->derivative_ptr[p->nderivative]);
    s->constants = doubles(b, p->nconst);
    s->blocks = doubles(b, p->nderivative);
    s->gap = doubles(b, p->nhold);
    s->spread = doubles(b, p->nhold ? (2 * p->nhold + 4) * p->k : 0);
    lay_lu(&s->lu, p, b);
}

static int larger(int a, int b) {
    return a > b ? a : b;
}

static void lay_chain(ph_instance *in, block *b) {
    const ph_plan *p = in->model->step, *q = in->model->instant;
    ph_chain *c = &in->chain;
    int local = 0, work = 0, iw = 0, arg = 0, res = 0;
    for (int i = 0; i < p->ngroup + q->ngroup; i++) {
        const ph_group *g = i < p->ngroup ? &p->groups[i] : &q->groups[i - p->ngroup];
        const ph_tangent *tangent = &in->model->tangents[g->kernel];
        local = larger(local, 2 * (g->nx + g->ny) + g->np + g->no);
        work = larger(work, tangent->w);
        iw = larger(iw, tangent->iw);
        arg = larger(arg, tangent->arg);
        res = larger(res, tangent->res);
    }
    c->x = doubles(b, p->nx + 1 + p->na);
    c->dy = doubles(b, larger(p->nv + p->nz, q->nv + q->nz));
    c->dr = doubles(b, larger(p->nrow, q->nrow));
    c->last = doubles(b, p->nw);
    c->basis = doubles(b, p->k * p->k);
    c->du = doubles(b, p->nu * p->k * p->nu);
    c->dx = doubles(b, p->nu * (p->nx + 1 + p->na));
    c->dy_node = doubles(b, p->nu * p->k * p->nu);
    c->local = doubles(b, local);
    c->work = doubles(b, work);
    c->iw = ints(b, iw);
    c->arg = take(b, sizeof(double *) * (size_t)arg);
    c->res = take(b, sizeof(double *) * (size_t)res);
}

static size_t lay_out(ph_instance *in, block *b) {
    size_t begin;
    take(b, sizeof(ph_instance));
    begin = b->used;
    lay_state(in, b);
    in->state_size = b->used - begin;
    lay_system(&in->step, in->model->step, b);
    lay_system(&in->instant, in->model->instant, b);
    if (in->model->step->schur && ph_schur_solver.size)
        in->schur = take(b, ph_schur_solver.size(in->model->step));
    in->backup = take(b, in->state_size);
    in->stored = doubles(b, in->model->step->ncomp);
    in->moved = doubles(b, in->model->step->ncomp);
    in->lost = doubles(b, in->model->step->ncomp);
    in->numerical = doubles(b, in->model->step->ncomp);
    in->energies = doubles(b, in->model->step->nq);
    in->means = doubles(b, in->model->step->nq);
    in->unspread = doubles(b, in->model->step->nhold > 0 ? in->model->step->nw : 0);
    in->basis = doubles(b, in->model->step->k);
    in->change = doubles(b, in->model->step->nx);
    if (in->model->tangents)
        lay_chain(in, b);
    return b->used;
}

static int plan_fits(const ph_plan *p, const ph_model *model) {
    const ph_plan *step = model->step;
    if (p->nx != step->nx || p->nu != step->nu || p->np != step->np || p->nq != step->nq ||
        p->na != step->na || p->nhold != step->nhold || p->ncomp != step->ncomp ||
        p->nv != p->nw + p->nu * p->k + 1 || p->nrow != p->nw + p->nq * p->k + p->nobs)
        return 0;
    for (int i = 0; i < p->ngroup; i++) {
        const ph_group *g = &p->groups[i];
        const ph_kernel *kernel;
        if (g->kernel < 0 || g->kernel >= ph_nkernel)
            return 0;
        kernel = &ph_kernels[g->kernel];
        if (g->nx != kernel->nx || g->ny != kernel->ny || g->np != kernel->np || g->no != kernel->no ||
            g->nj != kernel->nj)
            return 0;
    }
    return 1;
}

static int model_fits(const ph_model *model) {
    return model->stamp == PH_STAMP && model->token == ph_kernel_token && model->instant->k == 1 &&
           plan_fits(model->step, model) && plan_fits(model->instant, model);
}

size_t ph_size(const ph_model *model) {
    ph_instance in = {0};
    block b = {0};
    if (!model_fits(model))
        return 0;
    in.model = model;
    ph_layout(model, in.offset);
    return lay_out(&in, &b);
}

int ph_init(void *memory, const ph_model *model) {
    ph_instance *in = memory;
    block b = {0};
    if (!model_fits(model))
        return PH_ABI;
    memset(memory, 0, ph_size(model));
    b.base = memory;
    in->model = model;
    ph_layout(model, in->offset);
    lay_out(in, &b);
    if (in->schur)
        ph_schur_solver.init(in->schur, model->step);
    for (int i = 0; i < 2; i++) {
        ph_system *s = i ? &in->instant : &in->step;
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
            if (!p->increments[p->mean_w[l]])
                s->last[p->mean_w[l]] = a[p->mean_a[l]];
    }
    in->head->parts = 0;
    in->head->last_h[0] = 0.0; /* there is no last step to start from */
}

static void copy(double *to, const double *from, int n) {
    if (n > 0)
        memcpy(to, from, sizeof(double) * (size_t)n);
}

int ph_reset(ph_instance *in) {
    const ph_model *m = in->model;
    memset(in->head, 0, in->state_size);
    in->head->token = m->token;
    in->head->size = in->state_size;
    for (int i = 0; i < 2; i++) {
        ph_system *s = i ? &in->instant : &in->step;
        s->lu.ready = s->lu.filled = 0;
        if (s->plan->nw > 0)
            s->pivot[0] = -1;
    }
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
    const int length = in->offset[PH_NBLOCK], together = in->table[p->nx] == from->table[p->nx];
    if (length != from->offset[PH_NBLOCK] || p->nx != q->nx || p->np != q->np || p->nu != q->nu ||
        p->ncomp != q->ncomp || p->nq != q->nq || (p->nu > 0 && !from->head->held))
        return PH_ARGUMENT;
    copy(in->table, from->table, length);
    copy(in->rest, from->rest, p->nx);
    copy(in->table_rest, from->table_rest, p->nq + 3 * p->ncomp);
    copy(in->p, from->p, p->np);
    if (!together) /* its own last step is no longer the one before the next */
        ph_seed(in, in->table + in->offset[PH_A]);
    in->head->parts = 0;
    in->head->dirty = 1;
    ph_rest_placed(in);
    ph_rest_continue(in, from);
    return ph_set_input(in, from->u);
}

size_t ph_state_size(const ph_instance *in) {
    return in->state_size;
}

void ph_save(const ph_instance *in, void *out) {
    memcpy(out, in->head, in->state_size);
}

int ph_load(ph_instance *in, const void *from) {
    const ptrdiff_t flags = (char *)in->step.rests - (char *)in->head;
    const size_t length = sizeof(int) * (size_t)in->model->step->nhold;
    ph_head head;
    int status, others;
    memcpy(&head, from, sizeof(head));
    if (head.token != in->model->token || head.size != in->state_size)
        return PH_ABI;
    others = length > 0 && memcmp(in->step.rests, (const char *)from + flags, length) != 0;
    memcpy(in->head, from, in->state_size);
    if (others)
        ph_rest_take(in);
    status = ph_lu_adopt(&in->step.lu, in->step.pivot);
    return status ? status : ph_lu_adopt(&in->instant.lu, in->instant.pivot);
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
