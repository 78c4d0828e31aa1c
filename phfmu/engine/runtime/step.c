/* Steps: solve a part, book it; halve a step that does not solve. */
#include <float.h>
#include <math.h>

#include "system.h"

/* The Schur stepper where the model has one and it leaves out the constraints that rest; else, or where it
 * does not converge, Newton's method. */
static int solve(ph_instance *in, double h) {
    ph_system *s = &in->step;
    in->fast = in->schur && in->planned && in->model->code->solver->solve(in->schur, s, h) == 0;
    if (!in->fast)
        return ph_solve(s, h);
    ph_eval_h(s, h);
    if (!s->resting) {
        ph_eval_late(s);
        return PH_OK;
    }
    ph_eval(s, 0, 0); /* what those that rest miss */
    return PH_OK;
}

/* Solve until no constraint at rest is needed; *called: some were. */
static int solve_held(ph_instance *in, double h, int *called) {
    for (;;) {
        int status = solve(in, h);
        if (status || !in->step.resting || !ph_rest_wake(in))
            return status;
        *called = 1;
    }
}

/* Solves and weighs a part of length h. The Schur stepper ends its sweeps by how they contract, which may be
 * luck, and near a loss of rank multipliers are so large that what is left of the constraints is energy: a
 * step of it that the ledger would not let pass is solved again until updates are rounding. */
static int solve_weighed(ph_instance *in, double h, int *called) {
    for (int strict = 0;; strict = 1) {
        int status;
        in->step.strict = strict;
        status = solve_held(in, h, called);
        if (status) {
            ph_explain(&in->step, status, &in->report);
            return status;
        }
        if (ph_weigh(in, h)) {
            in->report = (ph_report){.status = PH_NOT_FINITE, .row = -1, .column = -1};
            return PH_NOT_FINITE;
        }
        if (!in->fast || strict || ph_closes(in))
            return PH_OK;
        in->count[PH_SCHUR]--;
    }
}

/* Solves the part [from, from + weight] of the communication step [t, t+h]; of the state only the time and,
 * if it succeeds, the constraints that rest change. */
static int try_part(ph_instance *in, double t, double h, double from, double weight) {
    ph_system *s = &in->step;
    int status, called = 0;
    in->table[s->plan->nx] = t + h * from;
    ph_resample(in, from, weight, s->y + s->plan->nw);
    in->count[PH_SOLVES]++;
    status = solve_weighed(in, h * weight, &called);
    if (status) {
        in->report.spent = (int)(in->count[PH_ITERATIONS] - in->begun);
        in->report.time = t + h * from;
        in->report.h = h * weight;
    }
    if (called)
        ph_rest_settle(in, t + h * (from + weight), status == PH_OK);
    return status;
}

/* Internal step i of n; on failure it is halved, and its halves again, down to PH_DEPTH. The place is
 * counted in smallest substeps; its alignment tells how long the next substep may be. refused: the step as a
 * whole has been tried. */
static int walk(ph_instance *in, double t, double h, int i, int n, int refused) {
    const int all = PH_SMALLEST;
    for (int at = 0, length; at < all; at += length) {
        for (length = refused && at == 0 ? all / 2 : all; at % length; length /= 2) {
        }
        for (;; length /= 2) {
            double from = (i + (double)at / all) / n, weight = (double)length / all / n;
            int status = try_part(in, t, h, from, weight);
            if (status == PH_OK) {
                ph_accept(in, h * weight, from, weight);
                if (length < all)
                    ph_part_ends(in, i, at + length);
                break;
            }
            if (length == 1 || in->count[PH_ITERATIONS] >= in->step.most)
                return status;
            in->count[PH_SUBSTEPS]++;
        }
    }
    return PH_OK;
}

/* An internal step begins: it may take so many iterations, `all` those of the communication step. */
static void allow(ph_instance *in, long long all) {
    in->begun = in->count[PH_ITERATIONS];
    in->step.most = in->begun + PH_MOST_ITERATIONS < all ? in->begun + PH_MOST_ITERATIONS : all;
}

/* A step of length zero is the identity: the state stays to the last bit, no energy moves, and the means of
 * the step are the limits for h -> 0, the values at the instant. */
static int stay(ph_instance *in, double t) {
    int status;
    in->table[in->step.plan->nx] = t;
    in->head->dirty = 1;
    status = ph_refresh(in);
    if (status)
        return status;
    ph_begin_step(in, 0.0);
    ph_take_instant(in, !in->step.plan->carries);
    in->count[PH_STEPS]++;
    return PH_OK;
}

int ph_is_sliver(const ph_instance *in, double t, double h) {
    return fabs(h) <= PH_SLIVER_CLOCK * DBL_EPSILON * fabs(t) ||
           fabs(h) <= PH_SLIVER_STEP * fabs(*in->step.last_h);
}

int ph_skip(ph_instance *in, double t) {
    if (!isfinite(t))
        return PH_ARGUMENT;
    in->table[in->step.plan->nx] = t;
    ph_clear_ledger(in);
    in->head->dirty = 1;
    in->count[PH_STEPS]++;
    return PH_OK;
}

/* 1 if a step begins with the factor of the last one. */
int ph_trusts(const ph_head *head) {
    return head->kept && head->unkept == 0;
}

/* Measures whether factors are worth keeping: one has served if the step takes no factor of its own, nor so
 * many iterations more than steps without that they cost as much. One that has served too few steps is a
 * loss, and the next steps do without. */
void ph_measure_trust(ph_head *head, int most, int trusts, int iterations, int factored) {
    if (!trusts) {
        head->usual = iterations;
        head->unkept -= head->unkept > 0;
    } else if (!factored && iterations <= head->usual + most) {
        head->served += head->served < PH_SERVED_STEPS;
    } else {
        head->unkept = head->served < PH_SERVED_STEPS ? PH_UNKEPT_STEPS : 1;
        head->served = 0;
    }
}

static int solve_whole(ph_instance *in, double t, double h) {
    ph_system *s = &in->step;
    const int trusts = ph_trusts(in->head) && ph_newton_recall(s) == PH_OK;
    const long long factored = in->count[PH_FACTORED], begun = in->count[PH_ITERATIONS];
    int status, iterations;
    s->trusts = trusts;
    status = try_part(in, t, h, 0.0, 1.0);
    s->trusts = 0;
    if (status)
        return status;
    iterations = (int)(in->count[PH_ITERATIONS] - begun);
    ph_measure_trust(in->head, s->plan->keep_most, trusts, iterations, in->count[PH_FACTORED] != factored);
    return PH_OK;
}

/* The step as one part, which is what nearly all steps are: solved before anything of the state changes, it
 * needs no copy to come back to. */
static int whole(ph_instance *in, double t, double h) {
    double *time = in->table + in->step.plan->nx, before = *time;
    int status = solve_whole(in, t, h);
    *time = before;
    if (status)
        return status;
    ph_begin_step(in, h);
    *time = t;
    ph_accept(in, h, 0.0, 1.0);
    ph_finish_step(in, t + h);
    return PH_OK;
}

static int advance(ph_instance *in, double t, double h, int n) {
    const long long all = in->count[PH_ITERATIONS] + PH_MOST_ITERATIONS + (long long)n * PH_MORE_ITERATIONS;
    int refused = 0;
    if (!isfinite(t + h) || n < 1)
        return PH_ARGUMENT;
    if (in->head->placed)
        ph_rest_choose(in);
    allow(in, all);
    if (n == 1 && h != 0.0) {
        if (whole(in, t, h) == PH_OK)
            return PH_OK;
        in->count[PH_SUBSTEPS]++;
        refused = 1;
    }
    ph_save(in, in->backup);
    if (h == 0.0) {
        int status = stay(in, t);
        if (status == PH_OK)
            return status;
        in->count[PH_FAILED]++;
        ph_load(in, in->backup);
        return status;
    }
    ph_begin_step(in, h);
    ph_parts_begin(in, n);
    for (int i = 0; i < n; i++) {
        int status;
        if (i > 0)
            allow(in, all);
        status = walk(in, t, h, i, n, refused);
        if (status == PH_OK)
            continue;
        in->count[PH_FAILED]++;
        in->report.solved = i;
        ph_load(in, in->backup);
        return status;
    }
    ph_finish_step(in, t + h);
    return PH_OK;
}

int ph_step_parts(ph_instance *in, double t, double h, int n) {
    if (isfinite(t + h) && n >= 1 && h != 0.0 && ph_is_sliver(in, t, h))
        return ph_skip(in, t + h);
    return advance(in, t, h, n);
}

int ph_step_exactly(ph_instance *in, double t, double h, int n) {
    return advance(in, t, h, n);
}

int ph_step(ph_instance *in, double t, double h) {
    return ph_step_parts(in, t, h, 1);
}
