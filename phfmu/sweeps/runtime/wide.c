/* See wide.h. The sources of a step once more, with vectors as their numbers, and Newton's method with a
 * decision for each run. */
#include "lane_width.h"
#define PH_WIDTH PH_LANE_WIDTH

#define ph_accept ph_wide_accept_
#define ph_basis ph_wide_basis
#define ph_begin_step ph_wide_begin_step
#define ph_book_nodes ph_wide_book_nodes
#define ph_clear_ledger ph_wide_clear_ledger
#define ph_closes ph_wide_closes
#define ph_eval ph_wide_eval
#define ph_eval_derivatives ph_wide_eval_derivatives
#define ph_eval_h ph_wide_eval_h
#define ph_eval_late ph_wide_eval_late
#define ph_eval_ledger ph_wide_eval_ledger
#define ph_eval_matrix ph_wide_eval_matrix
#define ph_finish_step ph_wide_finish_step
#define ph_inputs_at ph_wide_inputs_at
#define ph_interpret_full ph_wide_interpret_full
#define ph_interpret_ledger ph_wide_interpret_ledger
#define ph_interpret_value ph_wide_interpret_value
#define ph_lay_out ph_wide_lay_out
#define ph_layout ph_wide_layout
#define ph_lu_adopt ph_wide_lu_adopt
#define ph_lu_refactor ph_wide_lu_refactor
#define ph_lu_solve ph_wide_lu_solve
#define ph_lu_take ph_wide_lu_take
#define ph_newton_bare ph_wide_newton_bare
#define ph_newton_factor ph_wide_newton_factor
#define ph_resample ph_wide_resample
#define ph_sizes_of ph_wide_sizes_of
#define ph_state_arrays ph_wide_state_arrays
#define ph_weigh ph_wide_weigh

#include "wide.h"

#include "attempts.c"
#include "eval.c"
#include "inputs.c"
#include "interpret.c"
#include "ledger.c"
#include "lu.c"
#include "memory.c"
#include "newton.c"

struct ph_wide {
    ph_model model;
    ph_instance in;
    ph_array arrays[PH_STATE_ARRAYS];
    ph_real *value; /* of the factors, before new ones are taken; as are the next three */
    ph_real *inverse;
    ph_real *scale;
    ph_real *factored;
    unsigned recalled; /* runs whose factors are to be made from s->kept */
};

static size_t lay(ph_wide *w, char *memory) {
    const ph_plan *p = w->model.step;
    ph_pool pool = {memory, ph_padded(sizeof(ph_wide))};
    w->in.model = &w->model;
    w->value = ph_take_reals(&pool, p->lucap);
    w->inverse = ph_take_reals(&pool, p->nw);
    w->scale = ph_take_reals(&pool, p->nw);
    w->factored = ph_take_reals(&pool, p->nnz);
    return pool.used + ph_lay_out(&w->in, memory ? memory + pool.used : NULL);
}

static ph_model with_code(const ph_model *model, const ph_code *code) {
    ph_model own = *model;
    own.code = code;
    own.tangents = NULL;
    return own;
}

size_t ph_wide_size(const ph_model *model, const ph_code *code) {
    ph_wide w = {.model = with_code(model, code)};
    return lay(&w, NULL);
}

ph_wide *ph_wide_init(void *memory, const ph_model *model, const ph_code *code) {
    ph_wide *w = memory;
    ph_system *s;
    memset(memory, 0, ph_wide_size(model, code));
    w->model = with_code(model, code);
    lay(w, memory);
    ph_state_arrays(&w->in, w->arrays);
    s = &w->in.step;
    s->code = code;
    s->x = w->in.table;
    s->rest = w->in.rest;
    s->p = w->in.p;
    s->last_h = &w->in.head->last_h[0];
    s->count = w->in.count;
    s->v[0] = PH_REAL_SPREAD(1.0);
    s->hp[1] = NAN;
    if (w->in.schur)
        code->solver->init(w->in.schur, model->step);
    return w;
}

const ph_array *ph_wide_arrays(const ph_wide *w) {
    return w->arrays;
}

int ph_wide_prepare(ph_wide *w, const int *pivot, double last_h, int held) {
    ph_system *s = &w->in.step;
    *s->last_h = last_h;
    w->in.head->held = held;
    if (w->in.schur)
        return PH_OK;
    if (ph_lu_adopt(&s->lu, pivot))
        return PH_SINGULAR;
    s->lu.filled = 0;
    return PH_OK;
}

/* Keeps the numbers `before` of the runs that are not `taken`. */
static void blend(ph_real *values, const ph_real *before, int n, ph_truth taken) {
    for (int i = 0; i < n; i++)
        values[i] = PH_REAL_WHERE(taken, values[i], before[i]);
}

static void copy(ph_real *to, const ph_real *from, int n) {
    memcpy(to, from, sizeof(ph_real) * (size_t)n);
}

void ph_wide_recall(ph_wide *w, int l, const double *kept) {
    ph_real *matrix = w->in.step.kept;
    for (int e = 0; e < w->model.step->nnz; e++)
        matrix[e][l] = kept[e];
    w->recalled |= 1U << l;
}

ph_array ph_wide_kept(const ph_wide *w) {
    return (ph_array){(double *)w->in.step.factored, w->model.step->nnz};
}

/* Runs whose matrix is another one than that of their factors. */
static unsigned changed(const ph_system *s) {
    ph_truth found = {0};
    for (int e = 0; e < s->plan->nnz; e++)
        found |= (ph_truth)s->a[e] ^ (ph_truth)s->factored[e];
    return PH_BITS(found);
}

/* New factors of the `fresh` runs at the present matrix; those of which a pivot is too small. `kept` ones
 * have what they had. */
static unsigned factor(ph_wide *w, unsigned fresh, unsigned kept) {
    ph_system *s = &w->in.step;
    ph_lu *lu = &s->lu;
    const int n = s->plan->nw, nnz = s->plan->nnz, entries = lu->start[n];
    const ph_truth taken = PH_TRUTH(~kept);
    if (kept) {
        copy(w->value, lu->value, entries);
        copy(w->inverse, lu->inverse, n);
        copy(w->scale, s->scale, n);
        copy(w->factored, s->factored, nnz);
    }
    ph_newton_factor(s);
    if (kept) {
        blend(lu->value, w->value, entries, taken);
        blend(lu->inverse, w->inverse, n, taken);
        blend(s->scale, w->scale, n, taken);
        blend(s->factored, w->factored, nnz, taken);
    }
    return PH_BITS(lu->refused) & fresh;
}

/* Newton's method from the w in Y; the runs that it has solved. */
static unsigned newton(ph_wide *w, unsigned going, unsigned keeping, ph_wide_cost *cost) {
    ph_system *s = &w->in.step;
    const int n = s->plan->nw;
    ph_course course[PH_WIDTH];
    unsigned found = 0;
    ph_real sum;
    for (int l = 0; l < PH_WIDTH; l++)
        course[l] = ph_course_begun(keeping >> l & 1 ? PH_KEPT : PH_CHORD);
    for (int i = 1; going && i <= PH_NEWTON_ITERATIONS; i++) {
        unsigned fresh = 0, astray = 0;
        ph_real update;
        for (int l = 0; l < PH_WIDTH; l++)
            fresh |= (going >> l & 1 && !course[l].chord ? 1U : 0U) << l;
        ph_eval(s, fresh != 0, 0);
        if (fresh) {
            ph_eval_matrix(s);
            cost->factored |= changed(s) & fresh;
            going &= ~factor(w, fresh, (going | found) & ~fresh);
        }
        sum = scale_residual(s);
        going &= PH_BITS(sum - sum == 0.0);
        ph_lu_solve(&s->lu, s->rhs, s->dw);
        copy(s->base, s->y, n);
        update = correct(s, s->base, 1.0);
        blend(s->y, s->base, n, PH_TRUTH(going));
        for (int l = 0; l < PH_WIDTH; l++) {
            ph_verdict verdict;
            if (!(going >> l & 1))
                continue;
            cost->iterations[l] = i;
            if (isfinite(update[l])) {
                ph_course_watch(&course[l], update[l]);
                verdict = ph_course_verdict(&course[l], 0);
                found |= (verdict == PH_SOLVED ? 1U : 0U) << l;
                if (verdict == PH_UNSOLVED) {
                    astray |= (unsigned)ph_course_goes_on(&course[l], PH_CHORD) << l;
                    continue;
                }
            }
            going &= ~(1U << l);
        }
        if (astray) { /* as for one run: rounding makes it not quite what it was */
            copy(s->base, s->y, n);
            correct(s, s->base, -1.0);
            blend(s->y, s->base, n, PH_TRUTH(astray));
        }
    }
    if (!found)
        return 0;
    ph_eval(s, 0, 0);
    scale_residual(s);
    ph_lu_solve(&s->lu, s->rhs, s->dw);
    for (int i = 0; i < n; i++)
        s->y[i] -= s->dw[i];
    ph_eval(s, 0, 1);
    sum = PH_REAL_SPREAD(0.0);
    for (int i = 0; i < s->plan->nrow; i++)
        sum += s->r[i] - s->r[i];
    return found & PH_BITS(sum == 0.0);
}

/* The factors of the runs that have entered with a kept matrix; those that cannot be had. */
static unsigned recall(ph_wide *w, unsigned wanted) {
    ph_system *s = &w->in.step;
    const unsigned recalled = w->recalled & wanted;
    w->recalled = 0;
    if (!recalled)
        return 0;
    copy(s->a, s->kept, s->plan->nnz);
    s->hp[1] = NAN; /* its constant entries may belong to another step size */
    return factor(w, recalled, wanted & ~recalled);
}

/* Newton's method from the last step. */
static unsigned search(ph_wide *w, double h, unsigned wanted, unsigned trusting, ph_wide_cost *cost) {
    ph_system *s = &w->in.step;
    ph_eval_h(s, h);
    start_guess(s, s->last, h / *s->last_h);
    return newton(w, wanted, h == *s->last_h ? trusting : 0, cost);
}

/* The Schur stepper. */
static unsigned sweep(ph_wide *w, double h, unsigned wanted) {
    ph_system *s = &w->in.step;
    unsigned solved;
    s->wanted = wanted;
    solved = wanted & ~w->in.model->code->solver->solve(w->in.schur, s, h);
    if (solved) {
        ph_eval_h(s, h);
        ph_eval_late(s);
    }
    return solved;
}

unsigned ph_wide_solve(ph_wide *w, double t, double h, unsigned wanted, unsigned trusting,
                       ph_wide_cost *cost) {
    ph_instance *in = &w->in;
    ph_system *s = &in->step;
    ph_real *time = in->table + s->plan->nx, before = *time;
    unsigned solved;
    *cost = (ph_wide_cost){0};
    wanted &= ~recall(w, wanted);
    *time = PH_REAL_SPREAD(t);
    ph_resample(in, 0.0, 1.0, s->y + s->plan->nw);
    solved = in->schur ? sweep(w, h, wanted) : search(w, h, wanted, trusting, cost);
    if (solved)
        solved &= ~PH_BITS(ph_weigh(in, h));
    if (solved && in->schur)
        solved &= PH_BITS(ph_closes(in));
    *time = before;
    return solved;
}

void ph_wide_accept(ph_wide *w, double t, double h) {
    ph_instance *in = &w->in;
    ph_begin_step(in, h);
    in->table[in->step.plan->nx] = PH_REAL_SPREAD(t);
    ph_accept(in, h, 0.0, 1.0);
    ph_finish_step(in, t + h);
}
