/* Constraints at rest: of redundant rows of Dg as many as needed are left out, w = 0 in their place, so that
 * the rest are independent. Which ones may change in motion, and one that is no longer redundant comes back.
 * The motion depends on neither; multipliers of least norm are given, whichever rests.
 * docs/proofs/constraints.md. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "system.h"

#define ROUNDS 50   /* of conjugate gradients */
#define SMALL 1e-14 /* slope along the null vectors, of the forces */

/* Counts those that rest. Factors and constant entries of A depend on which. */
void ph_rest_take(ph_instance *in) {
    const ph_plan *p = in->step.plan;
    int n = 0;
    in->planned = 1;
    for (int c = 0; c < p->nhold; c++) {
        n += in->step.rests[c] == PH_RESTS;
        in->planned &= (in->step.rests[c] == PH_RESTS) == p->hold_rests[c];
    }
    for (int i = 0; i < 2; i++) {
        ph_system *s = i ? &in->instant : &in->step;
        s->resting = n;
        s->hp[1] = NAN;
        s->lu.ready = s->lu.filled = 0;
    }
}

/* Begin with the constraints at rest of the plan. */
void ph_rest_begin(ph_instance *in) {
    const ph_plan *p = in->step.plan;
    if (p->nhold > 0)
        memcpy(in->step.rests, p->hold_rests, sizeof(int) * (size_t)p->nhold);
    ph_rest_take(in);
}

/* Continue with the constraints at rest of another instance of the declaration. */
void ph_rest_continue(ph_instance *in, const ph_instance *from) {
    const int n = in->step.plan->nhold;
    if (n > 0 && n == from->step.plan->nhold) {
        memcpy(in->step.rests, from->step.rests, sizeof(int) * (size_t)n);
        in->step.pivot[0] = in->instant.pivot[0] = -1;
        in->head->placed = from->head->placed;
        ph_rest_take(in);
    }
}

/* First row of constraint c. */
int ph_rest_first(const ph_plan *p, int c) {
    return p->hold_row[p->hold_ptr[c]];
}

/* Size of the forces of a unit of multiplier j. */
static double force(const ph_system *s, int j) {
    const ph_plan *p = s->plan;
    double sum = 0.0;
    for (int e = p->colptr[j]; e < p->colptr[j + 1]; e++)
        if (p->matrix_row[e] != j)
            sum += s->a[e] * s->a[e];
    return sqrt(sum);
}

/* Row, and unknown, of multiplier a % k of constraint a / k. */
static int multiplier(const ph_plan *p, int a) {
    return p->hold_row[p->hold_ptr[a / p->k] + a % p->k];
}

/* Slopes of half the sum of squares of the forces along the null vectors, X^T D^2 w, into dw; the sums
 * themselves into total (k). */
static void take_slopes(ph_system *s, const double *size, const double *w, double *total) {
    const ph_plan *p = s->plan;
    memset(s->rhs, 0, sizeof(double) * (size_t)p->nw);
    memset(total, 0, sizeof(double) * (size_t)p->k);
    for (int a = 0; a < p->nhold * p->k; a++) {
        int row = multiplier(p, a);
        double each = size[a] * w[row];
        s->rhs[row] = size[a] * each;
        total[a % p->k] += each * each;
    }
    ph_lu_solve_transposed(&s->lu, s->rhs, s->dw);
}

/* Adds to the multipliers w (nw) at the nodes the combination X t of null vectors of Dg^T that makes the sum
 * of squares of their forces least; X t = A^-1 E t, E the rows at rest. Conjugate gradients, the nodes side
 * by side, sizes D of the forces as scales. */
static void spread(ph_system *s, double *w) {
    const ph_plan *p = s->plan;
    const int k = p->k, n = p->nhold * k;
    double *size = s->spread, *way = size + n, *slope = way + n, *before = slope + k, *total = before + k,
           *fall = total + k;
    for (int a = 0; a < n; a++) {
        size[a] = force(s, multiplier(p, a));
        way[a] = 0.0;
    }
    for (int round = 0; round < ROUNDS; round++) {
        double *length = total;
        int going = 0;
        take_slopes(s, size, w, total);
        memcpy(before, slope, sizeof(double) * (size_t)k);
        memset(slope, 0, sizeof(double) * (size_t)k);
        for (int a = 0; a < n; a++)
            if (s->rests[a / k] == PH_RESTS && size[a] > 0.0) {
                double down = s->dw[multiplier(p, a)] / size[a];
                slope[a % k] += down * down;
            }
        for (int i = 0; i < k; i++)
            going |= slope[i] > SMALL * SMALL * total[i];
        if (!going)
            return;
        memset(s->rhs, 0, sizeof(double) * (size_t)p->nw);
        memset(fall, 0, sizeof(double) * (size_t)k);
        for (int a = 0; a < n; a++)
            if (s->rests[a / k] == PH_RESTS && size[a] > 0.0) {
                double turn = round > 0 && before[a % k] > 0.0 ? slope[a % k] / before[a % k] : 0.0;
                way[a] = turn * way[a] - s->dw[multiplier(p, a)] / (size[a] * size[a]);
                fall[a % k] -= way[a] * s->dw[multiplier(p, a)];
                s->rhs[multiplier(p, a)] = way[a];
            }
        ph_lu_solve(&s->lu, s->rhs, s->dw);
        memset(length, 0, sizeof(double) * (size_t)k);
        for (int a = 0; a < n; a++) {
            double each = size[a] * s->dw[multiplier(p, a)];
            length[a % k] += each * each;
        }
        for (int a = 0; a < n; a++)
            if (length[a % k] > 0.0)
                w[multiplier(p, a)] += fall[a % k] / length[a % k] * s->dw[multiplier(p, a)];
    }
}

/* The solution in Y with multipliers of least norm, and all rows at it. The null vectors are those of the
 * matrix there, not of the one that Newton's method was content with. */
void ph_rest_spread(ph_system *s) {
    const int resting = s->resting;
    ph_eval(s, 1, 0);
    ph_eval_matrix(s);
    ph_newton_bare(s, 1);
    if (ph_newton_factor(s) == PH_OK)
        spread(s, s->y);
    s->resting = 0; /* their rows are not looked at any more */
    ph_eval(s, 0, 1);
    s->resting = resting;
}

/* Spread the force of one constraint at rest after a step of the Schur stepper, by the factors of that; 0 if
 * there are more, or if another one should rest soon, which takes the factor of A. */
static int spread_fast(ph_instance *in) {
    ph_system *s = &in->step;
    const ph_plan *p = s->plan;
    const int k = p->k;
    int rests = 0;
    if (!in->fast || s->resting != 1)
        return 0;
    while (s->rests[rests] != PH_RESTS)
        rests++;
    ph_eval(s, 1, 0);
    ph_eval_matrix(s);
    if (in->model->code->solver->depend(in->schur, s, p->hold_row + p->hold_ptr[rests]))
        return 0;
    for (int i = 0; i < k; i++) {
        const double least = force(s, multiplier(p, rests * k + i));
        double along = 0.0, total = 0.0;
        for (int c = 0; c < p->nhold; c++) {
            const int row = multiplier(p, c * k + i);
            const double size = c == rests ? least : force(s, row), share = size * s->dw[row];
            if (!(fabs(share) <= PH_REST_SHARE * least))
                return 0;
            along += share * size * s->y[row];
            total += share * share;
        }
        if (total > 0.0)
            for (int c = 0; c < p->nhold; c++)
                s->y[multiplier(p, c * k + i)] -= along / total * s->dw[multiplier(p, c * k + i)];
    }
    s->lu.filled = 0; /* of another step */
    s->resting = 0;
    ph_eval(s, 0, 1);
    s->resting = 1;
    return 1;
}

void ph_rest_spread_step(ph_instance *in) {
    if (!spread_fast(in))
        ph_rest_spread(&in->step);
}

/* Size of the forces of a unit of the first multiplier of constraint c. */
double ph_rest_force(const ph_system *s, int c) {
    return force(s, ph_rest_first(s->plan, c));
}

/* Largest force in a dependence dw, and whose it is among those that do not rest (-1: nobody's). */
static double largest(const ph_system *s, int *whose) {
    double most = 0.0;
    *whose = -1;
    for (int c = 0; c < s->plan->nhold; c++) {
        double size = s->rests[c] ? 0.0 : fabs(s->dw[ph_rest_first(s->plan, c)]);
        if (size > 0.0 && (size *= ph_rest_force(s, c)) > most) {
            most = size;
            *whose = c;
        }
    }
    return most;
}

/* The dependence in which constraint c has a force of 1, the null vector of Dg^T at the first node, into dw.
 */
void ph_rest_dependence(ph_system *s, int c) {
    const int row = ph_rest_first(s->plan, c);
    memset(s->rhs, 0, sizeof(double) * (size_t)s->plan->nw);
    s->rhs[row] = 1.0 / force(s, row);
    ph_lu_solve(&s->lu, s->rhs, s->dw);
}

/* Is there a share so small that somebody else has to rest? All dependences in one solution, with weights so
 * that they do not cancel. */
static int share_is_small(ph_system *s) {
    const ph_plan *p = s->plan;
    int whose;
    memset(s->rhs, 0, sizeof(double) * (size_t)p->nw);
    for (int c = 0; c < p->nhold; c++) {
        double weight = 1.0 + fmod(0.6180339887498949 * c, 1.0), size;
        if (s->rests[c] == PH_RESTS && (size = ph_rest_force(s, c)) > 0.0)
            s->rhs[ph_rest_first(p, c)] = weight / size;
    }
    ph_lu_solve(&s->lu, s->rhs, s->dw);
    return largest(s, &whose) > PH_REST_SHARE;
}

/* Remembers a change at the end of a step. */
void ph_rest_tell(ph_instance *in, double time, int rests, int needed) {
    in->changes[in->head->changes % PH_KEPT_CHANGES] = (ph_rest_change){time, rests, needed};
    in->head->changes++;
}

/* Another constraint rests in place of one whose share in their dependence has become small: without it the
 * others would soon depend on each other. The last unknowns move along the dependence until they are 0 there.
 */
void ph_rest_exchange(ph_instance *in, double time) {
    ph_system *s = &in->step;
    const ph_plan *p = s->plan;
    int from = -1, to = -1, whose;
    double most = PH_REST_SHARE;
    if (!s->lu.filled || !share_is_small(s))
        return;
    for (int c = 0; c < p->nhold; c++) {
        double size;
        if (s->rests[c] != PH_RESTS || !(ph_rest_force(s, c) > 0.0))
            continue;
        ph_rest_dependence(s, c);
        size = largest(s, &whose);
        if (size > most) {
            most = size;
            from = c;
            to = whose;
        }
    }
    if (from < 0)
        return;
    ph_rest_dependence(s, from);
    for (int i = 0; i < p->hold_ptr[to + 1] - p->hold_ptr[to]; i++) {
        const double t = s->last[p->hold_row[p->hold_ptr[to] + i]] / s->dw[ph_rest_first(p, to)];
        for (int c = 0; c < p->nhold; c++)
            s->last[p->hold_row[p->hold_ptr[c] + i]] -= t * s->dw[ph_rest_first(p, c)];
    }
    in->step.rests[from] = PH_AWAKE;
    in->step.rests[to] = PH_RESTS;
    s->pivot[0] = in->instant.pivot[0] = -1; /* those of another matrix */
    ph_rest_take(in);
    ph_rest_tell(in, time, to, from);
    in->count[PH_EXCHANGED]++;
}

/* After a solve: 1 if constraints that rest are not redundant; they do not rest any longer. */
int ph_rest_wake(ph_instance *in) {
    ph_system *s = &in->step;
    int found = 0;
    for (int c = 0; c < s->plan->nhold; c++)
        if (s->rests[c] == PH_RESTS && !(s->gap[c] <= PH_REST_GAP * s->plan->hold_size[c])) {
            s->rests[c] = PH_CALLED;
            found = 1;
        }
    if (found)
        ph_rest_take(in);
    return found;
}

/* Constraints that have come back stay if the step is accepted, else they rest as before. */
void ph_rest_settle(ph_instance *in, double time, int accepted) {
    int found = 0;
    for (int c = 0; c < in->step.plan->nhold; c++)
        if (in->step.rests[c] == PH_CALLED) {
            in->step.rests[c] = accepted ? PH_AWAKE : PH_RESTS;
            found = 1;
            if (accepted) {
                ph_rest_tell(in, time, -1, c);
                in->count[PH_WOKEN]++;
            }
        }
    if (found && !accepted)
        ph_rest_take(in);
}
