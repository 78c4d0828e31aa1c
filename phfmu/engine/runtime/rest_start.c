/* The constraints that rest at a state or with parameters that were set: the plan's, but not those that are
 * needed there, and those that depend on the others there. From the matrix of the instant system, whose
 * columns are the forces of the multipliers. */
#include <math.h>
#include <string.h>

#include "system.h"

void ph_rest_placed(ph_instance *in) {
    in->head->placed = in->step.plan->nhold > 0;
}

/* The largest force of the multipliers in dw, and the last constraint that has it. */
static double largest(const ph_system *s, int *whose) {
    double most = 0.0;
    *whose = -1;
    for (int last = 0; last < 2; last++)
        for (int c = 0; c < s->plan->nhold; c++) {
            double size = fabs(s->dw[ph_rest_first(s->plan, c)]) * ph_rest_force(s, c);
            if (!last && size > most)
                most = size;
            if (last && size > (1.0 - PH_REST_EQUAL) * most)
                *whose = c;
        }
    return most;
}

/* The norm of the sum of the forces of the multipliers in dw. */
static double together(ph_system *s) {
    const ph_plan *p = s->plan;
    double sum = 0.0;
    memset(s->base, 0, sizeof(double) * (size_t)p->nw);
    for (int c = 0; c < p->nhold; c++) {
        const int j = ph_rest_first(p, c);
        for (int e = p->colptr[j]; e < p->colptr[j + 1]; e++)
            if (p->matrix_row[e] != j)
                s->base[p->matrix_row[e]] += s->a[e] * s->dw[j];
    }
    for (int i = 0; i < p->nw; i++)
        sum += s->base[i] * s->base[i];
    return sqrt(sum);
}

/* Matrix and factor, bare or with delta, where these constraints rest; those without a force do. */
static int take(ph_instance *in, int bare) {
    ph_system *s = &in->instant;
    int found = 0;
    for (int round = 0; round == 0 || found; round++) {
        ph_rest_take(in);
        memcpy(s->y, s->last, sizeof(double) * (size_t)s->plan->nw);
        ph_inputs_at(in, in->head->theta, s->y + s->plan->nw);
        ph_eval_h(s, 1.0);
        ph_eval(s, 1, 0);
        ph_eval_matrix(s);
        found = 0;
        for (int c = 0; c < s->plan->nhold; c++)
            if (!s->rests[c] && ph_rest_force(s, c) == 0.0) {
                s->rests[c] = PH_RESTS;
                found = 1;
            }
    }
    ph_newton_bare(s, bare);
    return ph_newton_factor(s);
}

/* A constraint that depends on others that do not rest either, the one with the largest force in their
 * dependence; -1: none. Inverse iteration from weights that do not cancel. */
static int dependent(ph_system *s) {
    const ph_plan *p = s->plan;
    double most = 1.0;
    int whose = -1;
    for (int round = 0; round < PH_REST_ROUNDS && most > 0.0; round++) {
        memset(s->rhs, 0, sizeof(double) * (size_t)p->nw);
        for (int c = 0; c < p->nhold; c++) {
            const double size = ph_rest_force(s, c);
            const int row = ph_rest_first(p, c);
            if (s->rests[c] || !(size > 0.0))
                continue;
            s->rhs[row] =
                round ? size * (size * s->dw[row] / most) : size * (1.0 + fmod(0.6180339887498949 * c, 1.0));
        }
        ph_lu_solve(&s->lu, s->rhs, s->dw);
        most = largest(s, &whose);
    }
    return most > 0.0 && together(s) <= PH_REST_CANCELLED * most ? whose : -1;
}

/* Lets those that rest and are needed come back, and those with larger forces in a dependence rest instead.
 */
static int revise(ph_instance *in) {
    ph_system *s = &in->instant;
    int whose, changes = 0;
    if (take(in, 1))
        return PH_SINGULAR;
    for (int c = 0; c < s->plan->nhold && changes <= s->plan->nhold; c++) {
        double most;
        if (!s->rests[c] || !(ph_rest_force(s, c) > 0.0))
            continue;
        ph_rest_dependence(s, c);
        most = largest(s, &whose);
        if (together(s) > PH_REST_CANCELLED * most)
            whose = -1;
        else if (most <= PH_REST_SHARE)
            continue;
        s->rests[c] = PH_AWAKE;
        if (whose >= 0)
            s->rests[whose] = PH_RESTS;
        if (take(in, 1))
            return PH_SINGULAR;
        changes++;
        c = -1;
    }
    return PH_OK;
}

/* Remembers what is not as it was. */
static void tell(ph_instance *in, const double *before) {
    const int n = in->step.plan->nhold;
    int rests = 0, needed = 0;
    for (;;) {
        while (rests < n && (before[rests] != 0.0 || !in->step.rests[rests]))
            rests++;
        while (needed < n && (before[needed] == 0.0 || in->step.rests[needed]))
            needed++;
        if (rests == n && needed == n)
            return;
        ph_rest_tell(in, in->table[in->step.plan->nx], rests < n ? rests++ : -1, needed < n ? needed++ : -1);
        in->step.pivot[0] = in->instant.pivot[0] = -1; /* those of another matrix */
    }
}

void ph_rest_choose(ph_instance *in) {
    ph_system *s = &in->instant;
    const int n = s->plan->nhold;
    double *before = in->step.gap; /* not in use between steps */
    int status, c = 0;
    in->head->placed = 0;
    for (int i = 0; i < n; i++)
        before[i] = s->rests[i] == PH_RESTS;
    ph_rest_begin(in);
    status = take(in, 0);
    for (int i = 0; i < n && status == PH_OK && (c = dependent(s)) >= 0; i++) {
        s->rests[c] = PH_RESTS;
        status = take(in, 0);
    }
    if (status == PH_OK)
        status = revise(in);
    if (status)
        ph_rest_begin(in); /* the solve will say why */
    ph_rest_take(in);
    tell(in, before);
}
