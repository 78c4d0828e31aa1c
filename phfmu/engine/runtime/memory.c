/* Memory of an instance: one block, what it holds and where. */
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

size_t ph_lay_out(ph_instance *in, char *memory) {
    block whole = {memory, 0}, *b = &whole;
    size_t begin;
    ph_layout(in->model, in->offset);
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
