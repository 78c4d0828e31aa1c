/* Memory of an instance: one block, what it holds and where. */
#include "step_map.h"
#include "system.h"

void ph_sizes_of(const ph_model *model, ph_sizes *s) {
    const ph_plan *p = model->step;
    *s = (ph_sizes){.nx = p->nx,
                    .na = p->na,
                    .nu = p->nu,
                    .nq = p->nq,
                    .np = p->np,
                    .nobs = model->instant->nobs,
                    .ncomp = p->ncomp,
                    .k = p->k,
                    .weights = p->weights};
}

void ph_layout(const ph_model *model, int *offset) {
    ph_sizes s;
    ph_sizes_of(model, &s);
    ph_places(&s, offset);
}

static void lay_state(ph_instance *in, ph_pool *b) {
    const ph_plan *p = in->model->step;
    const int length[PH_NROW] = {p->ncomp, p->ncomp, p->ncomp, p->ncomp, p->ncomp, p->nq};
    in->head = ph_take(b, sizeof(ph_head));
    in->table = ph_take_reals(b, in->offset[PH_NBLOCK]);
    in->rest = ph_take_reals(b, p->nx);
    in->table_rest = ph_take_reals(b, p->nq + 3 * p->ncomp);
    for (int i = 0; i < PH_NROW; i++)
        in->row[i] = ph_take_reals(b, length[i]);
    in->u = ph_take_reals(b, p->nu * p->k);
    in->p = ph_take_reals(b, p->np);
    in->x_old = ph_take_reals(b, p->nx + 1 + p->na);
    in->u_old = ph_take_reals(b, p->nu * p->k);
    in->first = ph_take_reals(b, p->nw);
    in->y_node = ph_take_reals(b, p->k > 1 ? p->nq * p->k : 0);
    in->reach = ph_take_reals(b, p->schur ? p->ncomp : 0);
    in->changes = ph_take(b, p->nhold > 0 ? sizeof(ph_rest_change) * PH_KEPT_CHANGES : 0);
    in->step.last = ph_take_reals(b, p->nw);
    in->step.pivot = ph_take_ints(b, p->nw);
    in->step.kept = ph_take_reals(b, p->keep_most ? p->nnz : 0);
    in->step.rests = in->instant.rests = ph_take_ints(b, p->nhold);
    in->instant.last = ph_take_reals(b, in->model->instant->nw);
    in->instant.pivot = ph_take_ints(b, in->model->instant->nw);
}

/* The arrays of numbers of a state, in order; how many there are. */
int ph_state_arrays(ph_instance *in, ph_array *out) {
    const ph_plan *p = in->model->step;
    int n = 0;
    out[n++] = (ph_array){(double *)in->table, in->offset[PH_NBLOCK]};
    out[n++] = (ph_array){(double *)in->rest, p->nx};
    out[n++] = (ph_array){(double *)in->table_rest, p->nq + 3 * p->ncomp};
    for (int i = 0; i < PH_NROW; i++)
        out[n++] = (ph_array){(double *)in->row[i], i == PH_ROW_PAIRS ? p->nq : p->ncomp};
    out[n++] = (ph_array){(double *)in->u, p->nu * p->k};
    out[n++] = (ph_array){(double *)in->p, p->np};
    out[n++] = (ph_array){(double *)in->x_old, p->nx + 1 + p->na};
    out[n++] = (ph_array){(double *)in->u_old, p->nu * p->k};
    out[n++] = (ph_array){(double *)in->y_node, p->k > 1 ? p->nq * p->k : 0};
    out[n++] = (ph_array){(double *)in->reach, p->schur ? p->ncomp : 0};
    out[n++] = (ph_array){(double *)in->step.last, p->nw};
    return n;
}

static void lay_system(ph_system *s, const ph_plan *p, ph_pool *b) {
    s->plan = p;
    s->y = ph_take_reals(b, p->nv + p->nz);
    s->r = ph_take_reals(b, p->nrow);
    s->v = ph_take_reals(b, p->nslot);
    s->a = ph_take_reals(b, p->nnz);
    s->factored = ph_take_reals(b, p->nnz);
    s->scaled = ph_take_reals(b, p->nnz);
    s->scale = ph_take_reals(b, p->nw);
    s->rhs = ph_take_reals(b, p->nw);
    s->dw = ph_take_reals(b, p->nw);
    s->base = ph_take_reals(b, p->nw);
    s->loose = ph_take_reals(b, p->nhold ? p->nw : 0);
    s->products = ph_take_doubles(b, p->varying_ptr[p->nvarying]);
    s->fixed = ph_take_doubles(b, p->nnz);
    s->derivatives = ph_take_doubles(b, p->derivative_ptr[p->nderivative]);
    s->constants = ph_take_doubles(b, p->nconst);
    s->blocks = ph_take_reals(b, p->nderivative);
    s->gap = ph_take_reals(b, p->nhold);
    s->spread = ph_take_reals(b, p->nhold ? (2 * p->nhold + 4) * p->k : 0);
    s->lu.n = p->nw;
    s->lu.nnz = p->nnz;
    s->lu.capacity = p->lucap;
    s->lu.colptr = p->colptr;
    s->lu.rowind = p->matrix_row;
    s->lu.order = p->order;
    s->lu.prefer = p->pivot_row;
    ph_lu_take(&s->lu, b);
}

static int larger(int a, int b) {
    return a > b ? a : b;
}

static void lay_chain(ph_instance *in, ph_pool *b) {
    const ph_plan *p = in->model->step, *q = in->model->instant;
    ph_chain *c = &in->chain;
    int local = 0, work = 0, iw = 0, arg = 0, res = 0;
    for (int i = 0; i < p->ngroup + q->ngroup; i++) {
        const ph_group *g = i < p->ngroup ? &p->groups[i] : &q->groups[i - p->ngroup];
        const ph_function *tangent = &in->model->tangents[g->kernel];
        const ph_function *slope = in->model->slopes ? &in->model->slopes[g->kernel] : tangent;
        local = larger(local, 2 * (g->nx + g->ny + g->np) + g->no);
        work = larger(work, larger(tangent->w, slope->w));
        iw = larger(iw, larger(tangent->iw, slope->iw));
        arg = larger(arg, larger(tangent->arg, slope->arg));
        res = larger(res, larger(tangent->res, slope->res));
    }
    c->x = ph_take_doubles(b, p->nx + 1 + p->na);
    c->dy = ph_take_doubles(b, larger(p->nv + p->nz, q->nv + q->nz));
    c->dr = ph_take_doubles(b, larger(p->nrow, q->nrow));
    c->last = ph_take_doubles(b, p->nw);
    c->basis = ph_take_doubles(b, p->k * p->k);
    c->du = ph_take_doubles(b, p->nu * p->k * p->nu);
    c->dx = ph_take_doubles(b, p->nu * (p->nx + 1 + p->na));
    c->dy_node = ph_take_doubles(b, p->nu * p->k * p->nu);
    c->local = ph_take_doubles(b, local);
    c->work = ph_take_doubles(b, work);
    c->iw = ph_take_ints(b, iw);
    c->arg = ph_take(b, sizeof(double *) * (size_t)arg);
    c->res = ph_take(b, sizeof(double *) * (size_t)res);
}

size_t ph_lay_out(ph_instance *in, char *memory) {
    ph_pool whole = {memory, 0}, *b = &whole;
    const ph_schur_code *solver = in->model->code->solver;
    size_t begin;
    ph_layout(in->model, in->offset);
    ph_take(b, sizeof(ph_instance));
    begin = b->used;
    lay_state(in, b);
    in->state_size = b->used - begin;
    lay_system(&in->step, in->model->step, b);
    lay_system(&in->instant, in->model->instant, b);
    in->step.work = in->instant.work = ph_take_reals(b, ph_code_work(in->model->code));
    if (in->model->step->schur && solver && solver->size)
        in->schur = ph_take(b, solver->size(in->model->step));
    in->backup = ph_take(b, in->state_size);
    in->stored = ph_take_reals(b, in->model->step->ncomp);
    in->moved = ph_take_reals(b, in->model->step->ncomp);
    in->lost = ph_take_reals(b, in->model->step->ncomp);
    in->numerical = ph_take_reals(b, in->model->step->ncomp);
    in->given = ph_take_reals(b, in->model->step->schur ? in->model->step->ncomp : 0);
    in->in_play = ph_take_reals(b, in->model->step->schur ? in->model->step->ncomp : 0);
    in->energies = ph_take_reals(b, in->model->step->nq);
    in->means = ph_take_reals(b, in->model->step->nq);
    in->unspread = ph_take_reals(b, in->model->step->nhold > 0 ? in->model->step->nw : 0);
    in->basis = ph_take_doubles(b, in->model->step->k);
    in->change = ph_take_reals(b, in->model->step->nx);
    if (in->model->tangents)
        lay_chain(in, b);
    return b->used;
}
