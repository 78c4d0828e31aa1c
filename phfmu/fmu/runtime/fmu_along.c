/* Derivatives by states and parameters: of a communication step, of what is told of it and of the states at
 * its end by the states at its start; of values at the present time by the states there. With dx, dp and du
 * the directions of states, parameters and inputs, both are linear in them, and solved for once per call:
 *
 *     (dx1, dy_step, dy_node, da) = step along (dx0, du, dp),     (dy, da_end, dobs) = instant along (dx, du,
 * dp).
 *
 * Units with state events, and those of coupled members, do not have this file.
 */
#include <math.h>
#include <string.h>

#include "fmu.h"

/* What an unknown is of: the last step, the present time, or nothing that has derivatives. */
enum { NEITHER, OF_STEP, OF_NOW };

size_t fmu_along_room(const fmu_interface *about, const ph_sizes *p) {
    const int outputs = p->k * p->nu, n = about->impulses ? about->impulses->n : 0;
    return (size_t)(2 * outputs + p->nx + 1 + p->na + p->np + p->na + p->nobs + 2 * n + n * n);
}

/* The direction, laid out in the memory of the instance. */
static ph_directions direction(const fmu *f) {
    const ph_sizes *p = &f->sizes;
    double *du = f->direction, *dy = du + p->k * p->nu, *dx = dy + p->k * p->nu, *dp = dx + p->nx + 1 + p->na,
           *da = dp + p->np, *dobs = da + p->na;
    return (ph_directions){.n = 1, .du = du, .dx = dx, .dy = dy, .dp = dp, .da = da, .dobs = dobs};
}

/* Directions of the impulses at start and end (2 n), and behind them the change of their jump (n*n). */
static double *impulses_of(const fmu *f) {
    return direction(f).dobs + f->sizes.nobs;
}

static int kind_of(const fmu *f, const fmu_variable *v) {
    const ph_sizes *p = &f->sizes;
    if (v->block == PH_X || v->block == PH_A)
        return OF_STEP;
    if (v->block == PH_A_END || v->block == PH_OBSERVABLES || v->block == FMU_JUMP)
        return OF_NOW;
    if (v->block == FMU_NODE_OUTPUT && v->first % p->nq < p->nu)
        return OF_STEP;
    if (v->block == PH_Y_STEP && v->first < p->nu)
        return OF_STEP;
    return v->block == PH_Y_END && v->first < p->nu ? OF_NOW : NEITHER;
}

static int is_known(const fmu_variable *v) {
    return v->block == PH_X || v->block == FMU_PARAMETER || v->block == FMU_TUNABLE ||
           v->block == FMU_INPUT || v->block == FMU_NODE_INPUT || v->block == FMU_IMPULSE;
}

/* Whether a call is about more than outputs by inputs. */
int fmu_asks_along(const fmu *f, const unsigned *unknown, size_t nu, const unsigned *known, size_t nk) {
    const unsigned n = (unsigned)f->about->nvariable;
    for (size_t j = 0; j < nk; j++)
        if (known[j] < n) {
            const int block = f->about->variables[known[j]].block;
            if (block == PH_X || block == FMU_PARAMETER || block == FMU_TUNABLE)
                return 1;
        }
    for (size_t i = 0; i < nu; i++)
        if (unknown[i] < n) {
            const int block = f->about->variables[unknown[i]].block;
            if (block == PH_X || block == PH_A || block == PH_A_END || block == PH_OBSERVABLES ||
                block == FMU_JUMP)
                return 1;
        }
    return 0;
}

static int refuse(const fmu *f, const char *function, unsigned ref, const char *what) {
    const char *name = ref < (unsigned)f->about->nvariable ? f->about->variables[ref].name : "?";
    return fmu_refuse(f, "%s: '%s' %s", function, name, what);
}

/* Which of both the unknowns need: of[OF_STEP], of[OF_NOW]. */
static int check(const fmu *f, const char *function, const unsigned *unknown, size_t nu,
                 const unsigned *known, size_t nk, int *of) {
    const unsigned n = (unsigned)f->about->nvariable;
    for (size_t j = 0; j < nk; j++)
        if (known[j] >= n || !is_known(&f->about->variables[known[j]]))
            return refuse(f, function, known[j], "is no state, parameter or input to derive by");
    for (size_t i = 0; i < nu; i++) {
        const int kind = unknown[i] < n ? kind_of(f, &f->about->variables[unknown[i]]) : NEITHER;
        if (kind == NEITHER)
            return refuse(f, function, unknown[i],
                          "has no derivative; states, outputs of external ports, algebraic variables and "
                          "observables have");
        of[kind] = 1;
    }
    return FMU_OK;
}

/* Whether the last step has derivatives by its start. */
static int check_step(const fmu *f, const char *function) {
    if (f->phase.steps == 0.0)
        return fmu_refuse(
            f, "%s: no step was taken since the start, so that there is none to derive; take one first",
            function);
    if (f->phase.crossed)
        return fmu_refuse(
            f, "%s: parameters changed in the last step or after it; derivatives of it are not known",
            function);
    return FMU_OK;
}

/* Adds a part of the direction of a known. */
static void move(const fmu *f, const ph_directions *d, const fmu_variable *v, double by) {
    const ph_sizes *p = &f->sizes;
    double *du = f->direction, *dp = du + (d->dp - f->direction);
    by *= v->sign;
    for (int i = v->first; i < v->first + v->count; i++)
        if (v->block == PH_X)
            d->dx[i] += by;
        else if (v->block == FMU_NODE_INPUT)
            du[i] += by;
        else if (v->block == FMU_IMPULSE)
            impulses_of(f)[i] += by;
        else if (v->block == FMU_INPUT)
            for (int node = 0; node < p->k; node++)
                du[node * p->nu + i] += by;
        else
            dp[i] += by;
}

/* The change of an unknown. */
static double change(const fmu *f, const ph_directions *d, const fmu_variable *v) {
    const ph_sizes *p = &f->sizes;
    double sum = 0.0;
    for (int i = v->first; i < v->first + v->count; i++)
        if (v->block == PH_X)
            sum += d->dx[i];
        else if (v->block == PH_A || v->block == PH_A_END)
            sum += d->da[i];
        else if (v->block == PH_OBSERVABLES)
            sum += d->dobs[i];
        else if (v->block == FMU_JUMP)
            sum += impulses_of(f)[2 * f->about->impulses->n + i];
        else if (v->block == FMU_NODE_OUTPUT)
            sum += d->dy[i / p->nq * p->nu + i % p->nq];
        else if (v->block == PH_Y_END)
            sum += d->dy[i];
        else
            for (int node = 0; node < p->k; node++)
                sum += p->weights[node] * d->dy[node * p->nu + i];
    return v->sign * sum;
}

/* The impulses at its start, the step, and those at its end. */
static int through_step(fmu *f, const ph_directions *d) {
    const fmu_impulses *impulses = f->about->impulses;
    const double *ds = impulses_of(f);
    int status;
    if (!impulses)
        return ph_step_along(f->of, d);
    impulses->along(f->nodes.impulses, 0, 1, ds, d->dx);
    impulses->by(f->nodes.impulses, 0, d->dp, d->dx);
    status = ph_step_along(f->of, d);
    impulses->along(f->nodes.impulses, 1, 1, ds + impulses->n, d->dx);
    impulses->by(f->nodes.impulses, 1, d->dp, d->dx);
    return status;
}

static int through_instant(fmu *f, const ph_directions *d) {
    const fmu_impulses *impulses = f->about->impulses;
    if (impulses)
        impulses->jump_along(f->nodes.impulses, d->dx, d->dp, impulses_of(f) + 2 * impulses->n);
    return ph_end_along(f->of, d);
}

/* The direction of known j with a weight, or of all of them, through the step or the present time. */
static int solve(fmu *f, const char *function, int kind, const ph_directions *d, const unsigned *known,
                 size_t nk, const double *weights) {
    int status;
    memset(f->direction, 0, sizeof(double) * fmu_along_room(f->about, &f->sizes));
    for (size_t j = 0; j < nk; j++)
        move(f, d, &f->about->variables[known[j]], weights[j]);
    status = kind == OF_STEP ? through_step(f, d) : through_instant(f, d);
    return status ? fmu_solver(f, function, status) : FMU_OK;
}

int fmu_along(fmu *f, const char *function, int adjoint, const unsigned *unknown, size_t nu,
              const unsigned *known, size_t nk, const double *seed, double *result) {
    const ph_directions d = direction(f);
    const fmu_variable *v = f->about->variables;
    const double one = 1.0;
    const size_t calls = adjoint ? nk : 1;
    int of[3] = {0};
    if (check(f, function, unknown, nu, known, nk, of) || (of[OF_STEP] && check_step(f, function)))
        return FMU_ERROR;
    for (size_t i = 0; i < (adjoint ? nk : nu); i++)
        result[i] = 0.0;
    for (int kind = OF_STEP; kind <= OF_NOW; kind++)
        for (size_t j = 0; of[kind] && j < calls; j++) {
            if (solve(f, function, kind, &d, known + j, adjoint ? 1 : nk, adjoint ? &one : seed))
                return FMU_ERROR;
            for (size_t i = 0; i < nu; i++)
                if (kind_of(f, &v[unknown[i]]) == kind)
                    result[adjoint ? j : i] +=
                        adjoint ? seed[i] * change(f, &d, &v[unknown[i]]) : change(f, &d, &v[unknown[i]]);
        }
    for (size_t i = 0; i < (adjoint ? nk : nu); i++)
        if (!isfinite(result[i]))
            return fmu_refuse(f, "%s: a derivative times its seed is not finite", function);
    return FMU_OK;
}
