/* Kernels and functions that are interpreted: the loops of group.inc, and what CasADi's C text does, over
 * programs. */
#include <math.h>
#include <string.h>

#include "interpret.h"

#define PH_NUMBER(name, expression) PH_OP_##name,
enum { PH_UNARY(PH_NUMBER) PH_BINARY(PH_NUMBER) };

#ifdef PH_WIDTH /* number by number: functions are those that one number has */
#define PH_EACH for (int l = 0; l < PH_WIDTH; l++)
#define PH_AT(value) (value)[l]
#else
#define PH_EACH
#define PH_AT(value) (value)
#endif
#define PH_ONE(name, expression)                                                                             \
    case PH_OP_##name:                                                                                       \
        for (int j = 0; j < n; j++) {                                                                        \
            const ph_real x = w[o[j]];                                                                       \
            ph_real result;                                                                                  \
            PH_EACH {                                                                                        \
                const double a = PH_AT(x);                                                                   \
                PH_AT(result) = expression;                                                                  \
            }                                                                                                \
            r[j] = result;                                                                                   \
        }                                                                                                    \
        o += n;                                                                                              \
        break;
#define PH_TWO(name, expression)                                                                             \
    case PH_OP_##name:                                                                                       \
        for (int j = 0; j < n; j++) {                                                                        \
            const ph_real x = w[o[2 * j]], y = w[o[2 * j + 1]];                                              \
            ph_real result;                                                                                  \
            PH_EACH {                                                                                        \
                const double a = PH_AT(x), b = PH_AT(y);                                                     \
                PH_AT(result) = expression;                                                                  \
            }                                                                                                \
            r[j] = result;                                                                                   \
        }                                                                                                    \
        o += 2 * n;                                                                                          \
        break;

/* The operations, with constants and arguments in place; results follow at r. */
static void operate(const ph_program *p, const ph_real *w, ph_real *r) {
    const int *o = p->operand;
    for (int s = 0; s < p->nsegment; s++) {
        const int n = p->segment[2 * s + 1];
        switch (p->segment[2 * s]) { PH_UNARY(PH_ONE) PH_BINARY(PH_TWO) }
        r += n;
    }
}

static ph_real *begin(const ph_program *p, ph_real *w) {
    for (int i = 0; i < p->nconstant; i++)
        w[i] = PH_REAL_SPREAD(p->constant[i]);
    return w + p->nconstant;
}

/* Instance i of a group: gather and operate; `first`: the slot of its arguments. */
static void instance(const ph_kernel *k, const ph_program *p, const ph_group *g, const ph_point *at, int i,
                     ph_real *first) {
    const int *xi = g->xi + i * k->nx, *yi = g->yi + i * k->ny, *pi = g->pi + i * k->np;
    ph_real *x = first, *y = x + k->nx, *q = y + k->ny;
    for (int j = 0; j < k->nx; j++)
        x[j] = at->x[xi[j]];
    for (int j = 0; j < k->ny; j++)
        y[j] = at->y[yi[j]];
    for (int j = 0; j < k->np; j++)
        q[j] = at->p[pi[j]];
    operate(p, at->work, q + k->np);
}

static void scatter(const ph_kernel *k, const ph_program *p, const ph_group *g, const ph_point *at, int i,
                    ph_real *target) {
    const int *oi = g->oi + i * k->no;
    for (int j = 0; j < k->no; j++)
        target[oi[j]] += at->hp[g->power[j]] * at->work[p->out[j]];
}

void ph_interpret_value(const ph_kernel *self, const ph_group *g, const ph_point *at, ph_real *target) {
    const ph_program *p = ((const ph_programs *)self->program)->value;
    ph_real *first = begin(p, at->work);
    for (int i = 0; i < g->n; i++) {
        instance(self, p, g, at, i, first);
        scatter(self, p, g, at, i, target);
    }
}

void ph_interpret_full(const ph_kernel *self, const ph_group *g, const ph_point *at, ph_real *target,
                       ph_real *slots) {
    const ph_program *p = ((const ph_programs *)self->program)->full;
    ph_real *first = begin(p, at->work), *slot = slots + g->slot;
    for (int i = 0; i < g->n; i++, slot += self->nj) {
        instance(self, p, g, at, i, first);
        scatter(self, p, g, at, i, target);
        for (int j = 0; j < self->nj; j++)
            slot[j] = at->work[p->out[self->no + j]];
    }
}

void ph_interpret_ledger(const ph_kernel *self, const ph_group *g, const ph_point *at, ph_real *stored,
                         ph_real *moved, ph_real *lost, ph_real *numerical) {
    const ph_program *p = ((const ph_programs *)self->program)->ledger;
    ph_real *first = begin(p, at->work);
    for (int i = 0; i < g->n; i++) {
        const int owner = g->owner[i];
        instance(self, p, g, at, i, first);
        stored[owner] += at->work[p->out[0]];
        moved[owner] += PH_REAL_ABS(at->work[p->out[0]]);
        lost[owner] += at->work[p->out[1]];
        if (p->nresult > 2)
            numerical[owner] += at->work[p->out[2]];
    }
}

#ifndef PH_WIDTH
int ph_interpret_function(const ph_function *self, const double **arg, double **res, int *iw, double *w,
                          int mem) {
    const ph_program *p = self->program;
    double *to = begin(p, w);
    const int *out = p->out;
    for (int i = 0; i < p->nargument; i++)
        for (int j = 0; j < p->argument[i]; j++)
            *to++ = arg[i][j];
    (void)iw;
    (void)mem;
    operate(p, w, to);
    for (int i = 0; i < p->nresult; i++)
        for (int j = 0; j < p->result[i]; j++)
            res[i][j] = w[*out++];
    return 0;
}
#endif
