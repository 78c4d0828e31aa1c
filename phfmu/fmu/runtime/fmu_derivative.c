/* Directional derivatives of port outputs with respect to port inputs.
 *
 * With respect to held inputs: of outputs of a step (names in _step) the sensitivity of the step map, by the
 * implicit function theorem at the last step; of outputs at the present time that of the algebraic equations
 * there. With respect to inputs at nodes and impulses: of the step map, for outputs at nodes and at its end.
 * By states and parameters: fmu_along.c.
 */
#include <math.h>

#include "fmu.h"

/* Inputs held over a step, or inputs at its nodes and impulses. */
enum { HELD, AT_NODES };

static const fmu_variable *variable(const fmu *f, unsigned ref) {
    return ref < (unsigned)f->about->nvariable ? &f->about->variables[ref] : NULL;
}

static int refuse(const fmu *f, const char *function, const fmu_variable *v, const char *what) {
    return fmu_refuse(f, "%s: '%s' is %s", function, v ? v->name : "?", what);
}

/* Outputs of the step or outputs now, with respect to held inputs. */
static int check_output(const fmu *f, const char *function, unsigned ref, const int *block) {
    const fmu_variable *v = variable(f, ref);
    if (v && (v->block == PH_Y_STEP || v->block == PH_Y_END) && v->first < f->sizes.nu &&
        (*block < 0 || v->block == *block))
        return FMU_OK;
    if (v && v->block == FMU_NODE_OUTPUT)
        return refuse(f, function, v, "an output at a node; ask for its derivatives by inputs at nodes");
    return refuse(f, function, v,
                  v && *block >= 0 ? "not of the same kind as the other unknowns"
                                   : "not an output of an external port");
}

/* Outputs at nodes, or at the end of the step where there are impulses: the row of the node map, or -1. */
static int row_of(const fmu *f, const fmu_variable *v) {
    const ph_sizes *p = &f->sizes;
    if (v && v->block == FMU_NODE_OUTPUT && v->first % p->nq < p->nu)
        return v->first / p->nq * p->nu + v->first % p->nq;
    if (v && v->block == PH_Y_END && f->about->impulses && v->first < p->nu)
        return p->k * p->nu + v->first;
    return -1;
}

static int column_of(const fmu *f, const fmu_variable *v) {
    const ph_sizes *p = &f->sizes;
    return v->block == FMU_IMPULSE ? p->k * p->nu + v->first : v->first;
}

static int check_knowns(const fmu *f, const char *function, const unsigned *known, size_t n, int *kind) {
    for (size_t j = 0; j < n; j++) {
        const fmu_variable *v = variable(f, known[j]);
        const int nodes = v && (v->block == FMU_NODE_INPUT || v->block == FMU_IMPULSE);
        if (!nodes && !(v && v->block == FMU_INPUT))
            return refuse(f, function, v, "not an input of a port");
        if (j > 0 && nodes != *kind)
            return refuse(f, function, v,
                          nodes ? "no held input as the other knowns"
                                : "no input at a node as the other knowns");
        *kind = nodes ? AT_NODES : HELD;
    }
    return FMU_OK;
}

static int check_unknowns(const fmu *f, const char *function, const unsigned *unknown, size_t n, int kind,
                          int *block) {
    for (size_t i = 0; i < n; i++) {
        if (kind == HELD && check_output(f, function, unknown[i], block))
            return FMU_ERROR;
        if (kind == AT_NODES && row_of(f, variable(f, unknown[i])) < 0)
            return refuse(f, function, variable(f, unknown[i]),
                          f->about->impulses ? "neither an output at a node nor one at the present time"
                                             : "not an output at a node");
        *block = f->about->variables[unknown[i]].block;
    }
    return FMU_OK;
}

static int same_parameters(const fmu *f, const char *function) {
    if (!f->phase.crossed)
        return 1;
    fmu_refuse(f, "%s: parameters changed in the last step or after it; derivatives of it are not known",
               function);
    return 0;
}

/* The sensitivities of one kind of outputs, solved for once per step. */
static const double *map_of(fmu *f, const char *function, int block) {
    int status = PH_OK;
    if (block == PH_Y_STEP && !same_parameters(f, function))
        return NULL;
    if (block == PH_Y_STEP && !f->step_known) {
        status = f->map->sensitivity(f->of, f->step_derivative);
        f->step_known = status == PH_OK;
    } else if (block == PH_Y_END && !f->end_known) {
        status = f->map->sensitivity_end(f->of, f->end_derivative);
        f->end_known = status == PH_OK;
    }
    if (status) {
        fmu_solver(f, function, status);
        return NULL;
    }
    return block == PH_Y_STEP ? f->step_derivative : f->end_derivative;
}

/* Derivatives of the last step by inputs at nodes and impulses, solved for once. */
static int node_map(fmu *f, const char *function) {
    int status;
    if (!same_parameters(f, function))
        return FMU_ERROR;
    if (f->nodes.known)
        return FMU_OK;
    status = f->about->node_map(f);
    if (status)
        return fmu_solver(f, function, status);
    f->nodes.known = 1;
    return FMU_OK;
}

static double entry(const fmu *f, const double *map, const fmu_variable *unknown, const fmu_variable *known) {
    const ph_sizes *p = &f->sizes;
    const size_t nodes = (size_t)(p->k * p->nu), ends = (size_t)p->nu;
    size_t row, column;
    if (map)
        return map[unknown->first * p->nu + known->first];
    row = (size_t)row_of(f, unknown);
    column = (size_t)column_of(f, known);
    return row < nodes ? f->nodes.by_node[column * nodes + row]
                       : f->nodes.by_end[column * ends + row - nodes];
}

/* References are few: they are looked up again where they are used, which needs no memory. */
int fmu_derivative(fmu *f, const char *function, int adjoint, const unsigned *unknown, size_t nu,
                   const unsigned *known, size_t nk, const double *seed, double *result) {
    const fmu_variable *variables;
    const double *map = NULL;
    int block = -1, kind = HELD;
    if (fmu_allow(f, function, FMU_INITIALIZATION | FMU_STEP) ||
        fmu_given(f, function, (nu == 0 || unknown) && (nk == 0 || known)) ||
        fmu_given(f, function, ((adjoint ? nu : nk) == 0 || seed) && ((adjoint ? nk : nu) == 0 || result)))
        return FMU_ERROR;
    if (f->about->along && f->about->asks_along(f, unknown, nu, known, nk))
        return f->about->along(f, function, adjoint, unknown, nu, known, nk, seed, result);
    if (check_knowns(f, function, known, nk, &kind) || check_unknowns(f, function, unknown, nu, kind, &block))
        return FMU_ERROR;
    for (size_t i = 0; i < (adjoint ? nk : nu); i++)
        result[i] = 0.0;
    if (block < 0)
        return FMU_OK;
    if (kind == AT_NODES) {
        if (node_map(f, function))
            return FMU_ERROR;
    } else {
        if (block == PH_Y_STEP && f->phase.mode == FMU_INITIALIZATION)
            block = PH_Y_END; /* before the first step the means are the values of the start */
        map = map_of(f, function, block);
        if (!map)
            return FMU_ERROR;
    }
    variables = f->about->variables;
    for (size_t i = 0; i < nu; i++)
        for (size_t j = 0; j < nk; j++) {
            const fmu_variable *y = &variables[unknown[i]], *u = &variables[known[j]];
            double s = entry(f, map, y, u);
            result[adjoint ? j : i] += (y->sign == u->sign ? s : -s) * seed[adjoint ? i : j];
        }
    for (size_t i = 0; i < (adjoint ? nk : nu); i++)
        if (!isfinite(result[i]))
            return fmu_refuse(f, "%s: a derivative times its seed is not finite", function);
    return FMU_OK;
}
