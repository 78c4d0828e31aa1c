/* Reading and setting variables by value reference. */
#include <math.h>
#include <string.h>

#include "fmu.h"

static const fmu_variable *find(const fmu *f, const char *function, unsigned ref) {
    if (ref < (unsigned)f->about->nvariable)
        return &f->about->variables[ref];
    fmu_refuse(f, "%s: there is no variable with the value reference %u, the last is %d", function, ref,
               f->about->nvariable - 1);
    return NULL;
}

/* Whether a block is the result of solving at the present time; before the first step means are too. */
static int solved(const fmu *f, int block) {
    if (block >= PH_NBLOCK)
        return 0;
    return block >= PH_A_END ||
           (f->phase.mode == FMU_INITIALIZATION && (block == PH_A || block == PH_Y_STEP));
}

/* Where the entries of a block begin. */
static const double *block_of(const fmu *f, int block) {
    switch (block) {
    case FMU_PARAMETER:
        return ph_parameters(f->in);
    case FMU_INPUT:
        return ph_input(f->in);
    case FMU_ROW_STORED:
    case FMU_ROW_DISSIPATED:
    case FMU_ROW_SUPPLIED:
        return ph_ledger(f->in, PH_ROW_STORED + block - FMU_ROW_STORED);
    default:
        return ph_signals(f->in) + f->offset[block];
    }
}

static double value_of(const fmu *f, const fmu_variable *v) {
    const double *from = block_of(f, v->block);
    double sum = from[v->first];
    for (int i = 1; i < v->count; i++)
        sum += from[v->first + i];
    return sum;
}

int fmu_get(fmu *f, const char *function, const unsigned *ref, size_t n, double *values) {
    int stale = 0;
    if (fmu_allow(f, function, FMU_INITIALIZATION | FMU_STEP | FMU_TERMINATED))
        return FMU_ERROR;
    for (size_t i = 0; i < n; i++) {
        const fmu_variable *v = find(f, function, ref[i]);
        if (!v)
            return FMU_ERROR;
        stale = stale || solved(f, v->block);
    }
    if (stale) {
        int status = f->phase.mode == FMU_INITIALIZATION ? ph_initialise(f->in) : ph_refresh(f->in);
        if (status)
            return fmu_solver(f, function, status);
    }
    for (size_t i = 0; i < n; i++)
        values[i] = value_of(f, &f->about->variables[ref[i]]);
    return FMU_OK;
}

/* Inputs at any time, parameters and states until initialization ends. */
static int check_set(const fmu *f, const char *function, unsigned ref, double value) {
    const fmu_variable *v = find(f, function, ref);
    const int nx = f->about->model->step->nx;
    int start;
    if (!v)
        return FMU_ERROR;
    start = v->block == FMU_PARAMETER || (v->block == PH_X && v->first < nx);
    if (!start && v->block != FMU_INPUT)
        return fmu_refuse(f, "%s: '%s' is calculated and cannot be set", function, v->name);
    if (start && !(f->phase.mode & (FMU_INSTANTIATED | FMU_INITIALIZATION)))
        return fmu_refuse(f, "%s: '%s' is fixed after initialization", function, v->name);
    if (!isfinite(value))
        return fmu_refuse(f, "%s: '%s' = %g is not finite", function, v->name, value);
    return FMU_OK;
}

static void copy(double *to, const double *from, int n) {
    if (n > 0)
        memcpy(to, from, sizeof(double) * (size_t)n);
}

int fmu_set(fmu *f, const char *function, const unsigned *ref, size_t n, const double *values) {
    const ph_plan *plan = f ? f->about->model->step : NULL;
    int states = 0, inputs = 0, parameters = 0;
    if (fmu_allow(f, function, FMU_INSTANTIATED | FMU_INITIALIZATION | FMU_STEP))
        return FMU_ERROR;
    for (size_t i = 0; i < n; i++)
        if (check_set(f, function, ref[i], values[i]))
            return FMU_ERROR;
    copy(f->x, ph_signals(f->in), plan->nx);
    copy(f->u, ph_input(f->in), plan->nu);
    copy(f->p, ph_parameters(f->in), plan->np);
    for (size_t i = 0; i < n; i++) {
        const fmu_variable *v = &f->about->variables[ref[i]];
        int *changed = v->block == FMU_INPUT ? &inputs : v->block == FMU_PARAMETER ? &parameters : &states;
        double *to = v->block == FMU_INPUT ? f->u : v->block == FMU_PARAMETER ? f->p : f->x;
        to[v->first] = values[i];
        *changed = 1;
    }
    f->end_known = 0;
    if ((parameters && ph_set_parameters(f->in, f->p)) || (states && ph_set_x(f->in, fmu_time(f), f->x)) ||
        (inputs && ph_set_input(f->in, f->u)))
        return fmu_refuse(f, "%s: the values were refused", function);
    return FMU_OK;
}
