/* The attempts at one system: where Newton's method starts, and with what safeguards. */
#include <math.h>
#include <string.h>

#include "system.h"

static double power(double base, int n) {
    double result = 1.0;
    for (; n > 0; n--)
        result *= base;
    for (; n < 0; n++)
        result /= base;
    return result;
}

/* Start from the solution `known` (nw, not in Y) of another step; ratio = this step size / its step size. */
static void start_guess(ph_system *s, const ph_real *known, double ratio) {
    const ph_plan *p = s->plan;
    for (int i = 0; i < p->nw; i++) {
        ph_real sum = PH_REAL_SPREAD(0.0);
        for (int l = p->guess_ptr[i]; l < p->guess_ptr[i + 1]; l++)
            sum += p->guess_val[l] * known[p->guess_idx[l]] * power(ratio, p->guess_pow[l]);
        s->y[i] = sum;
    }
}

#ifndef PH_WIDTH
/* Start from rest: increments zero, algebraic values as they were. */
static void start_rest(ph_system *s) {
    for (int i = 0; i < s->plan->nw; i++)
        s->y[i] = s->plan->increments[i] ? 0.0 : s->last[i];
}

/* Newton's method from the w in Y. With delta it may end where updates crawl along what delta is as large as,
 * with rows at their floors and no better: from there it goes on without, and what it finds is taken. */
static int solve(ph_system *s, ph_newton_kind kind) {
    const size_t bytes = sizeof(double) * (size_t)s->plan->nw;
    int status = ph_newton(s, kind);
    if (status || s->bare || s->plan->nhold == 0 || s->plan->vanishing || s->update <= PH_TOLERANCE)
        return status;
    memcpy(s->loose, s->y, bytes);
    ph_newton_bare(s, 1);
    status = ph_newton(s, PH_FRESH);
    if (status == PH_OK)
        return status;
    ph_newton_bare(s, 0);
    memcpy(s->y, s->loose, bytes);
    ph_eval(s, 0, 1);
    return PH_OK;
}

/* Start without forces of constraints: near a loss of rank those of the last step may be as large as those
 * of this one, and opposite. As they enter linearly, Newton's method does not need them. */
static void start_free(ph_system *s) {
    const ph_plan *p = s->plan;
    for (int l = 0; l < p->hold_ptr[p->nhold]; l++)
        s->y[p->hold_row[l]] = 0.0;
}

/* Newton's method for a step h, from the last step or from rest; where there are constraints without delta,
 * so again without their last forces, then with delta, and that first where masses are vanishing; nothing
 * where there were enough iterations. */
static int attempt(ph_system *s, double h, int rest, ph_newton_kind kind) {
    const int ways = s->plan->nhold > 0 ? 3 : 1, delta = s->plan->vanishing ? 0 : ways - 1;
    const int without = delta == 0 ? 2 : 1;
    int status = PH_NO_CONVERGENCE;
    for (int i = 0; status && i < ways; i++) {
        if (s->count[PH_ITERATIONS] >= s->most)
            return PH_NO_CONVERGENCE;
        ph_newton_bare(s, i != delta);
        if (rest)
            start_rest(s);
        else
            start_guess(s, s->last, h / *s->last_h);
        if (i == without)
            start_free(s);
        status = solve(s, kind);
    }
    return status;
}

/* Solve from the solution of a shorter step, h/2, h/4 or h/8, by doubling. It stays on the branch that starts
 * at h = 0, and it enters the small region of convergence where a light mass moves fast on the curve that
 * stiff springs and bars leave it. */
static int grow(ph_system *s, double h) {
    const size_t bytes = sizeof(double) * (size_t)s->plan->nw;
    double part = 1.0;
    int status;
    do {
        part *= 0.5;
        ph_eval_h(s, part * h);
        status = attempt(s, part * h, *s->last_h == 0.0, PH_FRESH);
    } while (status && part > PH_SHORTEST);
    while (status == PH_OK && part < 1.0) {
        part *= 2.0;
        ph_eval_h(s, part * h);
        memcpy(s->base, s->y, bytes);
        start_guess(s, s->base, 2.0);
        status = solve(s, PH_FRESH);
    }
    ph_eval_h(s, h);
    return status;
}

/* Solves for step size h at the x, u and p in place: with a kept factor if the last step had this size, plain
 * from the guess, plain from rest, from shorter steps, damped from the guess, damped from rest. Nothing but
 * Y, R and work space is written. */
int ph_solve(ph_system *s, double h) {
    const int guessed = *s->last_h != 0.0;
    int status = PH_OK;
    ph_eval_h(s, h);
    if (s->plan->nw == 0) {
        s->iterations = 0;
        s->update = 0.0;
        ph_eval(s, 0, 1);
        return ph_finite(s->r, s->plan->nrow) ? PH_OK : PH_NOT_FINITE;
    }
    if (s->trusts && guessed && h == *s->last_h && attempt(s, h, 0, PH_KEPT) == PH_OK)
        return PH_OK;
    for (int damped = 0; damped < 2; damped++) {
        for (int rest = !guessed; rest < 2; rest++) {
            status = attempt(s, h, rest, damped ? PH_DAMPED : PH_CHORD);
            if (status)
                continue;
            s->count[PH_RESTARTS] += rest && guessed;
            s->count[PH_LINE_SEARCHES] += damped;
            return PH_OK;
        }
        if (!damped && s->plan->nupdate > 0 && grow(s, h) == PH_OK) {
            s->count[PH_RESTARTS]++;
            return PH_OK;
        }
    }
    return status;
}
#endif
