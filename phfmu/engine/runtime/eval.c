/* Gather and scatter: Z, R, V, A, derivative blocks and ledger of one system, with the rows of constraints
 * that rest left out. */
#include <math.h>
#include <string.h>

#include "system.h"

static void powers(const double *hp, const double *value, const signed char *power, int n, double *out) {
    for (int i = 0; i < n; i++)
        out[i] = value[i] * hp[power[i]];
}

/* Coefficients depend on h only: multiplied once per step size, not once per evaluation. */
void ph_eval_h(ph_system *s, double h) {
    const ph_plan *p = s->plan;
    s->y[p->nv - 1] = PH_REAL_SPREAD(h);
    if (h == s->hp[1])
        return;
    s->hp[0] = 1.0;
    s->hp[1] = h;
    s->hp[2] = h * h;
    powers(s->hp, p->varying_value, p->varying_power, p->varying_ptr[p->nvarying], s->products);
    powers(s->hp, p->derivative_value, p->derivative_power, p->derivative_ptr[p->nderivative],
           s->derivatives);
    powers(s->hp, p->const_val, p->const_pow, p->nconst, s->constants);
    for (int e = 0; e < p->nnz; e++)
        s->fixed[e] = 0.0;
    for (int l = 0; l < p->nfixed; l++)
        s->fixed[p->fixed_entry[l]] += p->fixed_value[l] * s->hp[p->fixed_power[l]];
    for (int e = 0; e < p->nnz; e++)
        s->a[e] = PH_REAL_SPREAD(s->fixed[e]);
}

/* w = 0 exactly, whatever rounding the factor leaves. */
static void rest_unknowns(ph_system *s) {
    const ph_plan *p = s->plan;
    for (int c = 0; c < p->nhold; c++)
        for (int q = p->hold_ptr[c]; s->rests[c] == PH_RESTS && q < p->hold_ptr[c + 1]; q++)
            s->y[p->hold_row[q]] = PH_REAL_SPREAD(0.0);
}

/* Rows 0, after a look at what they miss: the mean of the node rows is (g' - g) / h. */
static void rest_residual(ph_system *s) {
    const ph_plan *p = s->plan;
    for (int c = 0; c < p->nhold; c++) {
        const int *row = p->hold_row + p->hold_ptr[c], n = p->hold_ptr[c + 1] - p->hold_ptr[c];
        ph_real mean = PH_REAL_SPREAD(0.0), speed = mean;
        if (s->rests[c] != PH_RESTS)
            continue;
        if (n > p->k)
            speed = PH_REAL_ABS(s->r[row[p->k]]);
        for (int i = 0; i < p->k; i++)
            mean += p->weights[i] * s->r[row[i]];
        s->gap[c] = PH_REAL_WHERE(PH_REAL_ABS(mean) > speed, PH_REAL_ABS(mean), speed);
        for (int i = 0; i < n; i++)
            s->r[row[i]] = PH_REAL_SPREAD(0.0);
    }
}

/* Rows of A: 1 on the diagonal. */
static void rest_matrix(ph_system *s) {
    const ph_plan *p = s->plan;
    for (int c = 0; c < p->nhold; c++) {
        if (s->rests[c] != PH_RESTS)
            continue;
        for (int e = p->silent_ptr[c]; e < p->silent_ptr[c + 1]; e++)
            s->a[p->silent[e]] = PH_REAL_SPREAD(0.0);
        for (int q = p->hold_ptr[c]; q < p->hold_ptr[c + 1]; q++)
            s->a[p->hold_own[q]] = PH_REAL_SPREAD(1.0);
    }
}

/* Values of condensed variables, the last rows of R, join Y. */
static void take_condensed(ph_system *s) {
    const ph_plan *p = s->plan;
    const int n = p->ncondensed;
    if (n > 0)
        memcpy(s->y + p->nv + p->nz - n, s->r + p->nrow - n, sizeof(ph_real) * (size_t)n);
}

/* Z and R at (x, Y); slots: Jacobian entries into V too; late: pair outputs and observables too. */
void ph_eval(ph_system *s, int slots, int late) {
    const ph_plan *p = s->plan;
    ph_real *y = s->y, *z = s->y + p->nv, *r = s->r;
    const ph_point at = {s->x, y, s->p, s->hp, s->work};
    int i = 0, nconst = late ? p->nconst : p->nconst_early;
    memset(z, 0, sizeof(ph_real) * (size_t)p->nz);
    memset(r, 0, sizeof(ph_real) * (size_t)p->nrow);
    if (s->resting)
        rest_unknowns(s);
    for (int stage = 0; stage < 2; stage++) {
        for (; i < p->ngroup && p->groups[i].stage == stage; i++) {
            const ph_group *g = &p->groups[i];
            const ph_kernel *kernel = &s->code->kernels[g->kernel];
            ph_real *target = stage ? r : z;
            if (g->late && !late)
                continue;
            if (slots)
                kernel->full(kernel, g, &at, target, s->v);
            else
                kernel->value(kernel, g, &at, target);
        }
        if (stage == 0)
            for (int l = 0; l < nconst; l++)
                r[p->const_row[l]] += s->constants[l] * y[p->const_src[l]];
    }
    if (s->resting)
        rest_residual(s);
    if (late)
        take_condensed(s);
}

/* The rows after the residual, at a w and a Z found elsewhere. A kernel may give rows of both kinds at once,
 * as that of a port whose column depends on the state does: its force and its output. What is added to
 * residual rows is not looked at; the next evaluation clears them. */
void ph_eval_late(ph_system *s) {
    const ph_plan *p = s->plan;
    const ph_point at = {s->x, s->y, s->p, s->hp, s->work};
    memset(s->r + p->nw, 0, sizeof(ph_real) * (size_t)(p->nrow - p->nw));
    for (int i = 0; i < p->ngroup; i++) {
        const ph_group *g = &p->groups[i];
        if (g->reports)
            ph_value_of(s->code, g, &at, s->r);
    }
    for (int l = p->nconst_early; l < p->nconst; l++)
        s->r[p->const_row[l]] += s->constants[l] * s->y[p->const_src[l]];
    take_condensed(s);
}

/* Entries of A that are not constant at fixed h; the lists have no write conflicts. */
void ph_eval_matrix(ph_system *s) {
    const ph_plan *p = s->plan;
    const int *restrict ps = p->varying_s;
    const int *restrict pt = p->varying_t;
    const double *restrict c = s->products;
    const ph_real *restrict v = s->v;
    int l = 0;
    for (int i = 0; i < p->nvarying; i++) {
        int e = p->varying_entry[i], end = p->varying_ptr[i + 1];
        ph_real sum = s->fixed[e] + c[l] * v[ps[l]] * v[pt[l]]; /* most entries are one product */
        while (++l < end)
            sum += c[l] * v[ps[l]] * v[pt[l]];
        s->a[e] = sum;
    }
    if (s->resting)
        rest_matrix(s);
}

/* out: nderivative. */
void ph_eval_derivatives(ph_system *s, ph_real *out) {
    const ph_plan *p = s->plan;
    int l = 0;
    for (int e = 0; e < p->nderivative; e++)
        for (out[e] = PH_REAL_SPREAD(0.0); l < p->derivative_ptr[e + 1]; l++)
            out[e] += s->derivatives[l] * s->v[p->derivative_s[l]] * s->v[p->derivative_t[l]];
}

/* stored, moved, lost, numerical: ncomp each, overwritten; lost is a rate, to be multiplied by the step. */
void ph_eval_ledger(ph_system *s, ph_real *stored, ph_real *moved, ph_real *lost, ph_real *numerical) {
    const ph_plan *p = s->plan;
    const ph_point at = {s->x, s->y, s->p, s->hp, s->work};
    memset(stored, 0, sizeof(ph_real) * (size_t)p->ncomp);
    memset(moved, 0, sizeof(ph_real) * (size_t)p->ncomp);
    memset(lost, 0, sizeof(ph_real) * (size_t)p->ncomp);
    memset(numerical, 0, sizeof(ph_real) * (size_t)p->ncomp);
    for (int i = 0; i < p->ngroup; i++) {
        const ph_kernel *kernel = &s->code->kernels[p->groups[i].kernel];
        if (kernel->ledger)
            kernel->ledger(kernel, &p->groups[i], &at, stored, moved, lost, numerical);
    }
}
