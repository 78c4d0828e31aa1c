/* Directional derivatives of port outputs with respect to port inputs.
 *
 * Outputs of a step (names in _step): sensitivity of the step map, by the implicit function theorem at
 * the last step. Outputs at the present time: derivative of the algebraic equations there. */
#include <math.h>

#include "fmu.h"

static int output_place(const fmu *f, const char *function, unsigned ref, const int *block) {
    const int nu = f->about->model->step->nu, n = f->about->nvariable;
    const fmu_variable *v = ref < (unsigned)n ? &f->about->variables[ref] : NULL;
    if (v && (v->block == PH_Y_STEP || v->block == PH_Y_END) && v->first < nu &&
        (*block < 0 || v->block == *block))
        return v->first;
    fmu_refuse(f, "%s: '%s' is not %s", function, v ? v->name : "?",
               v && *block >= 0 ? "of the same kind as the other unknowns" : "an output of an external port");
    return -1;
}

static int input_place(const fmu *f, const char *function, unsigned ref) {
    const fmu_variable *v = ref < (unsigned)f->about->nvariable ? &f->about->variables[ref] : NULL;
    if (v && v->block == FMU_INPUT)
        return v->first;
    if (v && v->block == FMU_NODE_INPUT)
        fmu_refuse(f, "%s: '%s' is an input at a node; derivatives are with respect to held inputs", function,
                   v->name);
    else
        fmu_refuse(f, "%s: '%s' is not an input of a port", function, v ? v->name : "?");
    return -1;
}

/* The sensitivities of one kind of outputs, solved for once per step. */
static const double *map_of(fmu *f, const char *function, int block) {
    int status = PH_OK;
    if (block == PH_Y_STEP && !f->step_known) {
        status = ph_sensitivity(f->in, f->step_map);
        f->step_known = status == PH_OK;
    } else if (block == PH_Y_END && !f->end_known) {
        status = ph_sensitivity_end(f->in, f->end_map);
        f->end_known = status == PH_OK;
    }
    if (status) {
        fmu_solver(f, function, status);
        return NULL;
    }
    return block == PH_Y_STEP ? f->step_map : f->end_map;
}

/* References are few: they are looked up again where they are used, which needs no memory. */
int fmu_derivative(fmu *f, const char *function, int adjoint, const unsigned *unknown, size_t nu,
                   const unsigned *known, size_t nk, const double *seed, double *result) {
    const double *map;
    int block = -1, width;
    if (fmu_allow(f, function, FMU_INITIALIZATION | FMU_STEP) ||
        fmu_given(f, function, (nu == 0 || unknown) && (nk == 0 || known)) ||
        fmu_given(f, function, ((adjoint ? nu : nk) == 0 || seed) && ((adjoint ? nk : nu) == 0 || result)))
        return FMU_ERROR;
    width = f->about->model->step->nu;
    for (size_t i = 0; i < nu; i++) {
        if (output_place(f, function, unknown[i], &block) < 0)
            return FMU_ERROR;
        block = f->about->variables[unknown[i]].block;
    }
    for (size_t j = 0; j < nk; j++)
        if (input_place(f, function, known[j]) < 0)
            return FMU_ERROR;
    for (size_t i = 0; i < (adjoint ? nk : nu); i++)
        result[i] = 0.0;
    if (block < 0)
        return FMU_OK;
    if (block == PH_Y_STEP && f->phase.mode == FMU_INITIALIZATION)
        block = PH_Y_END; /* before the first step the means are the values of the start */
    map = map_of(f, function, block);
    if (!map)
        return FMU_ERROR;
    for (size_t i = 0; i < nu; i++)
        for (size_t j = 0; j < nk; j++) {
            const fmu_variable *y = &f->about->variables[unknown[i]], *u = &f->about->variables[known[j]];
            double s = map[y->first * width + u->first];
            result[adjoint ? j : i] += (y->sign == u->sign ? s : -s) * seed[adjoint ? i : j];
        }
    for (size_t i = 0; i < (adjoint ? nk : nu); i++)
        if (!isfinite(result[i]))
            return fmu_refuse(f, "%s: a derivative times its seed is not finite", function);
    return FMU_OK;
}
