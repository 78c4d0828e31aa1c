/* See side_by_side.h. */
#include "side_by_side.h"

#include <string.h>

enum { TABLE = 0, ROWS = 3 }; /* places in ph_state_arrays */
/* Longest absence of a run; steps after which it is halved; runs from which on the Schur stepper pays: it is
 * fast for one. */
enum { LONGEST = 64, RETURNS = 16, FEWEST = PH_LANE_WIDTH / 2 + 1 };

/* Size of the head, after which vectors are aligned as the whole is. */
static size_t head(void) {
    return (sizeof(ph_lanes) + 63) / 64 * 64;
}

size_t ph_lanes_size(const ph_model *model, const ph_code *code) {
    return head() + ph_wide_size(model, code);
}

/* Models whose steps have nothing but Newton's method from the last one, and no constraints that may rest, or
 * whose steps the solver of the code makes. */
int ph_lanes_init(void *memory, const ph_model *model, const ph_code *code, const ph_books *books) {
    const ph_plan *p = model->step;
    ph_lanes *lanes = memory;
    const int sweeps = code->solver && code->solver->size;
    if (p->nw == 0 || (p->schur && model->code->solver ? !sweeps : p->nhold > 0))
        return PH_ARGUMENT;
    memset(lanes, 0, sizeof(*lanes));
    lanes->wide = ph_wide_init((char *)memory + head(), model, code);
    lanes->books = books;
    lanes->sweeps = sweeps;
    ph_lanes_leave(lanes);
    for (int i = 0; i < PH_NROW; i++)
        lanes->row[i] = ph_wide_arrays(lanes->wide)[ROWS + i].data;
    return PH_OK;
}

long long ph_lanes_taken(const ph_lanes *lanes) {
    return lanes->taken;
}

/* Numbers of run l: out of the rows of all runs, or into them. */
static void take(const ph_array *rows, int l, double *to, int first, int n) {
    const double *from = rows->data + (ptrdiff_t)first * PH_LANE_WIDTH + l;
    for (int i = 0; i < n; i++)
        to[first + i] = from[(ptrdiff_t)i * PH_LANE_WIDTH];
}

static void place(const ph_array *rows, int l, const double *from) {
    for (int i = 0; i < rows->n; i++)
        rows->data[(ptrdiff_t)i * PH_LANE_WIDTH + l] = from[i];
}

static void leave(ph_lanes *lanes, int l) {
    const ph_array *rows = ph_wide_arrays(lanes->wide);
    ph_array own[PH_STATE_ARRAYS];
    ph_state_arrays(lanes->in[l], own);
    for (int i = 0; i < PH_STATE_ARRAYS; i++)
        take(&rows[i], l, own[i].data, 0, rows[i].n);
    if (lanes->in[l]->head->kept && !lanes->sweeps) {
        const ph_array kept = ph_wide_kept(lanes->wide);
        take(&kept, l, lanes->in[l]->step.kept, 0, kept.n);
        lanes->in[l]->step.holds = 0;
    }
    lanes->inside &= ~(1U << l);
}

void ph_lanes_leave(ph_lanes *lanes) {
    for (int l = 0; l < PH_LANE_WIDTH; l++)
        if (lanes->inside >> l & 1)
            leave(lanes, l);
    lanes->clock = 0;
    for (int l = 0; l < PH_LANE_WIDTH; l++)
        lanes->period[l] = 1;
}

/* 1 if the next step of an instance is one that lanes take. The Schur stepper is not asked where other
 * constraints rest than those that it leaves out, and what constraints at rest miss is looked at run by run.
 * It leaves factors of Newton's method as they are. */
static int usual(const ph_lanes *lanes, const ph_instance *in) {
    const ph_system *s = &in->step;
    if (*s->last_h == 0.0 || in->head->parts != 1 || in->head->placed)
        return 0;
    if (!lanes->sweeps)
        return s->lu.ready;
    return in->planned && !s->resting && (!in->head->kept || (s->holds && s->lu.filled));
}

/* 1 if the next step of an instance begins as that of the runs inside. */
static int alike(const ph_lanes *lanes, const ph_instance *a, const ph_instance *b) {
    if (*a->step.last_h != *b->step.last_h || a->head->held != b->head->held)
        return 0;
    return lanes->sweeps || memcmp(a->step.pivot, b->step.pivot, sizeof(int) * (size_t)a->step.plan->nw) == 0;
}

void ph_lanes_enter(ph_lanes *lanes, int l, ph_instance *in) {
    const ph_array *rows = ph_wide_arrays(lanes->wide);
    ph_array own[PH_STATE_ARRAYS];
    lanes->in[l] = in;
    ph_state_arrays(in, own);
    for (int i = ROWS; i < ROWS + PH_NROW; i++)
        place(&rows[i], l, own[i].data);
    if (!usual(lanes, in))
        return;
    if (lanes->clock % lanes->period[l])
        return;
    if (!lanes->inside) {
        if (ph_wide_prepare(lanes->wide, in->step.pivot, *in->step.last_h, in->head->held))
            return;
    } else {
        int other = 0;
        while (!(lanes->inside >> other & 1))
            other++;
        if (!alike(lanes, in, lanes->in[other]))
            return;
    }
    for (int i = 0; i < PH_STATE_ARRAYS; i++)
        place(&rows[i], l, own[i].data);
    if (in->head->kept && !lanes->sweeps)
        ph_wide_recall(lanes->wide, l, in->step.kept);
    lanes->inside |= 1U << l;
}

/* Updates the head of the instance of a run inside after its step; factors: whether it had any. */
static void follow(ph_instance *in, double h, int factors, int iterations, int factored) {
    const int most = in->step.plan->keep_most;
    ph_measure_trust(in->head, most, ph_trusts(in->head), iterations, factored);
    if (factors)
        in->head->kept = most > 0;
    *in->step.last_h = h;
    in->head->step_h = h;
    in->head->theta = 1.0;
    in->head->dirty = 1;
    in->count[PH_STEPS]++;
}

/* A step that lanes do not solve is lost time: a run with many of them enters less and less often. */
static void stay_away(ph_lanes *lanes, unsigned runs) {
    for (int l = 0; l < PH_LANE_WIDTH; l++)
        if (runs >> l & 1) {
            leave(lanes, l);
            if (lanes->period[l] < LONGEST)
                lanes->period[l] *= 2;
        }
}

static int count(unsigned runs) {
    int n = 0;
    for (; runs; runs &= runs - 1)
        n++;
    return n;
}

unsigned ph_lanes_step(ph_lanes *lanes, double t, double h) {
    ph_wide_cost cost;
    unsigned solved = 0, trusting = 0;
    lanes->clock++;
    if (lanes->sweeps && count(lanes->inside) < FEWEST)
        stay_away(lanes, lanes->inside);
    for (int l = 0; l < PH_LANE_WIDTH; l++)
        if (lanes->inside >> l & 1 && ph_is_sliver(lanes->in[l], t, h))
            leave(lanes, l);
    for (int l = 0; l < PH_LANE_WIDTH; l++)
        if (lanes->inside >> l & 1 && ph_trusts(lanes->in[l]->head))
            trusting |= 1U << l;
    if (lanes->inside && isfinite(t + h) && h != 0.0)
        solved = ph_wide_solve(lanes->wide, t, h, lanes->inside, trusting, &cost);
    stay_away(lanes, lanes->inside & ~solved);
    if (solved)
        ph_wide_accept(lanes->wide, t, h);
    for (int l = 0; l < PH_LANE_WIDTH; l++)
        if (solved >> l & 1) {
            follow(lanes->in[l], h, !lanes->sweeps, cost.iterations[l], cost.factored >> l & 1);
            if (lanes->clock % RETURNS == 0 && lanes->period[l] > 1)
                lanes->period[l] /= 2;
            lanes->taken++;
        }
    return solved;
}

void ph_lanes_show(const ph_lanes *lanes, int l, int first, int n) {
    take(&ph_wide_arrays(lanes->wide)[TABLE], l, (double *)lanes->in[l]->table, first, n);
}

void ph_lanes_show_energy(const ph_lanes *lanes, int l, double *energy) {
    const ph_array now = {(double *)lanes->books->now, lanes->books->ncomp};
    take(&now, l, energy, 0, now.n);
}
