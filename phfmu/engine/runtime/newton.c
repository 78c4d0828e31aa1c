/* Newton's method for one system from a given start: row scaling, damping, polish.
 *
 * The row-scaled matrix is factored. Delta on the diagonals of multipliers and node voltages, in the factor
 * only, leads past dependent rows, and past pivots that light masses leave to rounding. A model with
 * constraints is tried without it first (s->bare), where delta then only helps where there is no pivot: near
 * a loss of rank, and beside light masses, delta is as large as what is left of the constraints, and Newton's
 * method crawls. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "course.h"

/* delta on the diagonals of multipliers, small in units of their columns too: lambda enters as h, and beside
 * the Schur complement delta must not grow as steps become shorter. A column without entries (Dg = 0) gets
 * all of it. */
static void regularise(const ph_plan *p, ph_real *scaled) {
    for (int l = 0; l < p->nreg; l++) {
        int j = p->matrix_row[p->regularised[l]];
        ph_real most = PH_REAL_SPREAD(0.0), part;
        for (int e = p->colptr[j]; e < p->colptr[j + 1]; e++)
            most = PH_REAL_WHERE(PH_REAL_ABS(scaled[e]) > most, PH_REAL_ABS(scaled[e]), most);
        part = PH_DELTA_PART * most;
        scaled[p->regularised[l]] +=
            PH_REAL_WHERE((most > 0.0) & (part < PH_DELTA), part, PH_REAL_SPREAD(PH_DELTA));
    }
}

/* Sets whether factors are taken without delta; those of the other kind are not used again. */
void ph_newton_bare(ph_system *s, int bare) {
    if (s->bare != bare)
        s->lu.filled = 0;
    s->bare = bare;
}

/* Scale of every row = 1 / its largest entry, scaled matrix, factors. A matrix that has not changed since
 * (a linear model) is not factored again. */
int ph_newton_factor(ph_system *s) {
    const ph_plan *p = s->plan;
    const size_t bytes = sizeof(ph_real) * (size_t)p->nnz;
    ph_truth empty = {0};
    int status;
    if (s->lu.filled && memcmp(s->a, s->factored, bytes) == 0)
        return PH_OK;
    s->holds = 0;
    ph_real *restrict scale = s->scale;
    ph_real *restrict scaled = s->scaled;
    const ph_real *restrict a = s->a;
    for (int i = 0; i < p->nw; i++)
        scale[i] = PH_REAL_SPREAD(0.0);
    for (int e = 0; e < p->nnz; e++) {
        ph_real size = PH_REAL_ABS(a[e]);
        int i = p->matrix_row[e];
        scale[i] = PH_REAL_WHERE(size > scale[i], size, scale[i]);
    }
    s->empty = -1;
    s->lu.filled = 0; /* the scale goes with the factor */
    for (int i = 0; i < p->nw; i++) {
        empty |= PH_NOT(scale[i] > 0.0);
#ifndef PH_WIDTH
        if (!(scale[i] > 0.0))
            s->empty = i;
#endif
        scale[i] = 1.0 / scale[i];
    }
#ifndef PH_WIDTH
    if (empty)
        return PH_SINGULAR;
#endif
    for (int e = 0; e < p->nnz; e++)
        scaled[e] = a[e] * scale[p->matrix_row[e]];
    if (!s->bare)
        regularise(p, scaled);
#ifdef PH_WIDTH
    status = ph_lu_refactor(&s->lu, scaled);
    s->lu.refused |= empty;
#else
    status = ph_lu_factor(&s->lu, scaled, s->count);
    if (status == PH_SINGULAR && s->bare) { /* rows depend on each other just here: delta leads past it */
        regularise(p, scaled);
        status = ph_lu_factor(&s->lu, scaled, s->count);
    }
#endif
    if (status == PH_OK)
        memcpy(s->factored, s->a, bytes);
    return status;
}

#ifndef PH_WIDTH
/* The factor of the kept matrix with the pivots of the state, made again where another one has taken its
 * place: the same bits, as it is the same sums in the same order. */
int ph_newton_recall(ph_system *s) {
    if (s->holds && s->lu.filled)
        return PH_OK;
    if (ph_lu_adopt(&s->lu, s->pivot) || !s->lu.ready)
        return PH_SINGULAR;
    memcpy(s->a, s->kept, sizeof(double) * (size_t)s->plan->nnz);
    s->hp[1] = NAN; /* constant entries of A belong to another step size */
    s->lu.filled = 0;
    if (ph_newton_factor(s))
        return PH_SINGULAR;
    s->holds = 1;
    return PH_OK;
}
#endif

/* rhs = scale R; returns its squared 2-norm. */
static ph_real scale_residual(ph_system *s) {
    ph_real sum = PH_REAL_SPREAD(0.0);
    for (int i = 0; i < s->plan->nw; i++) {
        s->rhs[i] = s->scale[i] * s->r[i];
        sum += s->rhs[i] * s->rhs[i];
    }
    return sum;
}

/* w = base - damping dw; returns the scaled norm of dw, not finite if any entry is not. */
static ph_real correct(ph_system *s, const ph_real *base, double damping) {
    ph_real *w = s->y, most = PH_REAL_SPREAD(0.0), sum = most;
    for (int i = 0; i < s->plan->nw; i++) {
        ph_real size, dw = s->dw[i];
        w[i] = base[i] - damping * dw;
        size = PH_REAL_ABS(dw) / (s->plan->nominal[i] + PH_REAL_ABS(w[i]));
        sum += size;
        most = PH_REAL_WHERE(size > most, size, most);
    }
    return PH_REAL_WHERE(sum - sum == 0.0, most, sum);
}

#ifndef PH_WIDTH

/* 1 if constraints may lose rank beside masses that move by more than the rounding of forces; beside
 * vanishing ones the multipliers are what moves them. */
static int loses_rank(const ph_plan *p) {
    return p->nhold > 0 && !p->vanishing;
}

/* size (nw): what rounding leaves in each row, eps sum_j |A_ij| (|w_j| + |x_j|), x_j the state whose
 * increment w_j is. A residual of that size belongs to equations changed by eps alone. nominal = 1 judges
 * rows by the nominal size of their unknowns too, all of a model whose constraints may lose rank, else those
 * of multipliers: there the noise of others reaches rows in which all is zero, and multipliers crawl without
 * end for less. */
static void rounding(const ph_system *s, double nominal, double *size) {
    const ph_plan *p = s->plan;
    double *part = s->rhs; /* of the nominal size in a row */
    for (int i = 0; i < p->nw; i++) {
        size[i] = 0.0;
        part[i] = loses_rank(p) ? nominal : 0.0;
    }
    for (int l = 0; l < p->nreg; l++)
        part[p->matrix_row[p->regularised[l]]] = nominal;
    for (int u = 0; u < p->nupdate; u++)
        for (int l = p->update_ptr[u]; l < p->update_ptr[u + 1]; l++)
            for (int i = 0; i < p->update_n[u]; i++) {
                int j = p->update_w[l] + i;
                for (int e = p->colptr[j]; e < p->colptr[j + 1]; e++)
                    size[p->matrix_row[e]] += DBL_EPSILON * fabs(s->a[e] * s->x[p->update_x[u] + i]);
            }
    for (int j = 0; j < p->nw; j++)
        for (int e = p->colptr[j]; e < p->colptr[j + 1]; e++) {
            int i = p->matrix_row[e];
            size[i] += DBL_EPSILON * fabs(s->a[e]) * (fabs(s->y[j]) + part[i] * p->nominal[j]);
        }
}

/* All rows are rounding. */
static int at_floor(const ph_system *s, double nominal, double *size) {
    const ph_plan *p = s->plan;
    rounding(s, nominal, size);
    for (int l = 0; l < p->nreg; l++)
        size[p->matrix_row[p->regularised[l]]] *= PH_CONSTRAINT_SUMS;
    for (int i = 0; i < p->nw; i++)
        if (fabs(s->r[i]) > PH_FLOOR * size[i])
            return 0;
    return 1;
}

/* Halves the update until the scaled residual falls; where that is rounding the full one is taken. */
static int damp(ph_system *s, double norm, double *damping) {
    const int floor = at_floor(s, 0.0, s->base);
    memcpy(s->base, s->y, sizeof(double) * (size_t)s->plan->nw);
    for (*damping = 1.0; *damping >= PH_LEAST_DAMPING; *damping *= 0.5) {
        s->update = correct(s, s->base, *damping);
        if (!isfinite(s->update))
            return PH_NOT_FINITE;
        if (floor)
            return PH_OK;
        ph_eval(s, 0, 0);
        if (sqrt(scale_residual(s)) < norm)
            return PH_OK;
    }
    return PH_NO_CONVERGENCE;
}

/* Residual and, unless the last factor still serves, matrix and factor; rhs = scaled residual. */
static int linearise(ph_system *s, int chord, double *norm) {
    ph_eval(s, !chord, 0);
    if (!chord) {
        int status;
        ph_eval_matrix(s);
        status = ph_newton_factor(s);
        if (status)
            return status;
    }
    *norm = sqrt(scale_residual(s));
    return isfinite(*norm) ? PH_OK : PH_NOT_FINITE;
}

/* One more correction with the last factor; then all rows R at the final w. */
static int polish(ph_system *s) {
    ph_eval(s, 0, 0);
    scale_residual(s);
    ph_lu_solve(&s->lu, s->rhs, s->dw);
    for (int i = 0; i < s->plan->nw; i++)
        s->y[i] -= s->dw[i];
    ph_eval(s, 0, 1);
    return ph_finite(s->r, s->plan->nrow) ? PH_OK : PH_NOT_FINITE;
}

/* Scaled norm of the last update without multipliers of constraints. Near a loss of rank these are known as
 * badly as the forces in the lost directions are small; in the residual of the others they count with those.
 */
static double moved(const ph_system *s) {
    const ph_plan *p = s->plan;
    double most = 0.0;
    for (int i = 0; i < p->nw; i++)
        s->base[i] = fabs(s->dw[i]) / (p->nominal[i] + fabs(s->y[i]));
    for (int l = 0; l < p->hold_ptr[p->nhold]; l++)
        s->base[p->hold_row[l]] = 0.0;
    for (int i = 0; i < p->nw; i++)
        most = fmax(most, s->base[i]);
    return most;
}

/* 1 if the last update is small enough (course.h), the floor looked at where that decides. */
static int solved(const ph_system *s, const ph_course *c) {
    const int holds = loses_rank(s->plan);
    const ph_verdict verdict = ph_course_verdict(c, holds);
    if (verdict < PH_AT_FLOOR)
        return verdict == PH_SOLVED;
    if (holds && moved(s) > (verdict == PH_CRAWLS ? PH_CRAWLING : PH_STAGNATION))
        return 0;
    return at_floor(s, holds || verdict == PH_CRAWLS, s->base);
}

/* Solve from the w in Y; afterwards Y and all rows R belong to the final w. */
int ph_newton(ph_system *s, ph_newton_kind kind) {
    const int damped = kind == PH_DAMPED;
    ph_course course = ph_course_begun(kind);
    s->update = INFINITY;
    for (s->iterations = 1; s->iterations <= PH_NEWTON_ITERATIONS; s->iterations++) {
        double norm, damping = 1.0;
        int status = linearise(s, course.chord, &norm);
        if (status)
            return status;
        ph_lu_solve(&s->lu, s->rhs, s->dw);
        s->count[PH_ITERATIONS]++;
        if (damped) {
            status = damp(s, norm, &damping);
            if (status)
                return status;
        } else {
            s->update = correct(s, s->y, 1.0);
            if (!isfinite(s->update))
                return PH_NOT_FINITE;
        }
        ph_course_watch(&course, s->update);
        if (damping == 1.0 && solved(s, &course))
            return polish(s);
        if (ph_course_goes_on(&course, kind))
            correct(s, s->y, -1.0);
    }
    s->iterations = PH_NEWTON_ITERATIONS;
    return PH_NO_CONVERGENCE;
}

/* Why a solve failed: the row with the largest scaled residual (the first one that is not finite), and
 * for a singular matrix the empty row and the unknown without a pivot. */
void ph_explain(ph_system *s, int status, ph_report *report) {
    *report = (ph_report){.status = status, .row = -1, .column = -1};
    report->update = s->update;
    report->iterations = s->iterations;
    if (status == PH_SINGULAR) {
        report->row = s->empty;
        report->column = s->empty < 0 ? s->lu.failed : -1;
        return;
    }
    ph_eval(s, 1, 0); /* the matrix is that of the last start of an iteration */
    ph_eval_matrix(s);
    rounding(s, 0.0, s->base);
    for (int i = 0; i < s->plan->nw; i++) {
        double size = fabs(s->scale[i] * s->r[i]);
        if (size <= report->residual)
            continue;
        report->residual = size;
        report->floor = s->scale[i] * s->base[i];
        report->row = i;
        if (!isfinite(size))
            return;
    }
}

/* dw = A^-1 rhs with one refinement, which removes the delta of the factor; rhs is scaled in place. */
void ph_solve_refined(ph_system *s) {
    const ph_plan *p = s->plan;
    double *rhs = s->rhs, *correction = s->base;
    for (int i = 0; i < p->nw; i++)
        rhs[i] *= s->scale[i];
    ph_lu_solve(&s->lu, rhs, s->dw);
    for (int j = 0; j < p->nw; j++)
        for (int e = p->colptr[j]; e < p->colptr[j + 1]; e++)
            rhs[p->matrix_row[e]] -= s->scale[p->matrix_row[e]] * s->a[e] * s->dw[j];
    ph_lu_solve(&s->lu, rhs, correction);
    for (int i = 0; i < p->nw; i++)
        s->dw[i] += correction[i];
}
#endif
