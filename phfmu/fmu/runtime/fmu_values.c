/* Reading and setting variables by value reference. */
#include <math.h>
#include <string.h>

#include "fmu_modes.h"

static const fmu_variable *find(const fmu *f, const char *function, unsigned ref) {
    if (ref < (unsigned)f->about->nvariable)
        return &f->about->variables[ref];
    fmu_refuse(f, "%s: there is no variable with the value reference %u, the last is %d", function, ref,
               f->about->nvariable - 1);
    return NULL;
}

double *fmu_impulse_values(const fmu *f, int *n) {
    const fmu_impulses *impulses = f->about->impulses;
    *n = impulses ? 4 * impulses->n : 0;
    return impulses ? impulses->values(f->nodes.impulses) : NULL;
}

int fmu_kicked(const fmu *f) {
    int n, found = 0;
    const double *s = fmu_impulse_values(f, &n);
    for (int i = 0; i < n / 2; i++)
        found |= s[i] != 0.0;
    return found;
}

/* Whether a block is the result of solving at the present time; before the first step means are too. */
static int solved(const fmu *f, int block) {
    if (block == PH_A || block == PH_Y_STEP || block == FMU_NODE_OUTPUT)
        return f->phase.mode == FMU_INITIALIZATION;
    return (block >= PH_A_END && block < PH_NBLOCK) || block == FMU_GAP;
}

/* Where the entries of a block begin. */
static const double *block_of(const fmu *f, int block) {
    switch (block) {
    case FMU_PARAMETER:
    case FMU_TUNABLE:
    case FMU_MODE:
        return f->map->parameters(f->of);
    case FMU_HAPPENED:
        return f->phase.happened;
    case FMU_JOINED:
        return f->map->joined(f->of);
    case FMU_JUMPED:
        return f->books.jumped;
    case FMU_INPUT:
    case FMU_NODE_INPUT:
        return f->map->input(f->of);
    case FMU_NODE_OUTPUT:
        return f->map->node_outputs(f->of);
    case FMU_ROW_STORED:
    case FMU_ROW_DISSIPATED:
    case FMU_ROW_SUPPLIED:
    case FMU_ROW_NUMERICAL:
    case FMU_ROW_MOVED:
        return f->map->ledger(f->of, PH_ROW_STORED + block - FMU_ROW_STORED);
    case FMU_ROW_PAIRS:
        return f->map->ledger(f->of, PH_ROW_PAIRS);
    case FMU_IMPULSE:
        return f->about->impulses->values(f->nodes.impulses);
    case FMU_JUMP:
        return f->nodes.jump;
    default:
        return f->map->signals(f->of) + f->offset[block];
    }
}

/* H - H(start) - booked changes; before the start nothing is asked of the ledger. */
static double gap_of(const fmu *f, const fmu_variable *v) {
    const double *energy = f->map->signals(f->of) + f->offset[PH_H];
    double sum = 0.0;
    for (int c = v->first; f->phase.mode != FMU_INITIALIZATION && c < v->first + v->count; c++)
        sum += (energy[c] - f->books.start[c] - f->books.jumped[c]) - f->books.booked[c] + f->books.rest[c];
    return sum;
}

static double value_of(const fmu *f, const fmu_variable *v) {
    const ph_sizes *p = &f->sizes;
    const double *from;
    double sum;
    if (v->block == FMU_GAP)
        return gap_of(f, v);
    from = block_of(f, v->block);
    sum = from[v->first];
    for (int i = 1; v->block == FMU_INPUT && i < p->k; i++) /* of values at nodes, their mean */
        sum += p->weights[i] * (from[i * p->nu + v->first] - from[v->first]);
    for (int i = 1; i < v->count; i++)
        sum += from[v->first + i];
    return v->sign < 0 ? -sum : sum;
}

int fmu_get(fmu *f, const char *function, const unsigned *ref, size_t n, double *values) {
    int stale = 0, jump = 0;
    if (fmu_allow(f, function, FMU_INITIALIZATION | FMU_STEP | FMU_TERMINATED) ||
        fmu_given(f, function, n == 0 || (ref && values)))
        return FMU_ERROR;
    for (size_t i = 0; i < n; i++) {
        const fmu_variable *v = find(f, function, ref[i]);
        if (!v)
            return FMU_ERROR;
        stale = stale || solved(f, v->block);
        jump = jump || v->block == FMU_JUMP;
    }
    if (stale) {
        int status = f->phase.mode == FMU_INITIALIZATION ? f->map->initialise(f->of) : f->map->refresh(f->of);
        if (status)
            return fmu_solver(f, function, status);
    }
    if (jump)
        f->about->impulses->jump(f->nodes.impulses, f->nodes.jump);
    for (size_t i = 0; i < n; i++)
        values[i] = value_of(f, &f->about->variables[ref[i]]);
    for (size_t i = 0; i < n; i++) /* sums over components may overflow where their terms do not */
        if (!isfinite(values[i]))
            return fmu_refuse(f, "%s: '%s' is not finite", function, f->about->variables[ref[i]].name);
    return FMU_OK;
}

static int check_range(const fmu *f, const char *function, const fmu_range *range, double value) {
    const char *name = f->about->variables[range->variable].name;
    if (value < range->min || (range->above && value == range->min))
        return fmu_refuse(f, "%s: the parameter %s = %.9g must be %s %.9g", function, name, value,
                          range->above ? "above" : "at least", range->min);
    if (value > range->max)
        return fmu_refuse(f, "%s: the parameter %s = %.9g must be at most %.9g", function, name, value,
                          range->max);
    return FMU_OK;
}

/* Of a parameter that is set between steps. */
static int check_own_range(const fmu *f, const char *function, unsigned ref, double value) {
    for (int i = 0; i < f->about->nrange; i++)
        if (f->about->ranges[i].variable == (int)ref)
            return check_range(f, function, &f->about->ranges[i], value);
    return FMU_OK;
}

/* Inputs and tunable parameters at any time, other parameters and states until initialization ends. */
static int check_set(const fmu *f, const char *function, unsigned ref, double value) {
    const fmu_variable *v = find(f, function, ref);
    const int nx = f->sizes.nx;
    int start, late;
    if (!v)
        return FMU_ERROR;
    start = v->block == FMU_PARAMETER || v->block == FMU_MODE || (v->block == PH_X && v->first < nx);
    late = !(f->phase.mode & (FMU_INSTANTIATED | FMU_INITIALIZATION));
    if (!start && v->block != FMU_INPUT && v->block != FMU_NODE_INPUT && v->block != FMU_TUNABLE &&
        v->block != FMU_IMPULSE)
        return fmu_refuse(f, "%s: '%s' is calculated and cannot be set", function, v->name);
    if (start && late)
        return fmu_refuse(f, "%s: '%s' is fixed after initialization", function, v->name);
    if (!isfinite(value))
        return fmu_refuse(f, "%s: '%s' = %g is not finite", function, v->name, value);
    return late && v->block == FMU_TUNABLE ? check_own_range(f, function, ref, value) : FMU_OK;
}

static void copy(double *to, const double *from, int n) {
    if (n > 0)
        memcpy(to, from, sizeof(double) * (size_t)n);
}

/* Where the value of a variable goes; notes what changes: parameters, inputs, states, impulses. */
static double *place_of(fmu *f, const fmu_variable *v, int *changed) {
    switch (v->block) {
    case FMU_PARAMETER:
    case FMU_TUNABLE:
    case FMU_MODE:
        changed[0] = 1;
        return f->p + v->first;
    case FMU_INPUT:
    case FMU_NODE_INPUT:
        changed[1] = 1;
        return f->u + v->first;
    case FMU_IMPULSE:
        changed[3] = 1;
        return f->nodes.s + v->first;
    default:
        changed[2] = 1;
        return f->x + v->first;
    }
}

int fmu_held(const fmu *f, const double *u) {
    const ph_sizes *p = &f->sizes;
    for (int i = p->nu; i < p->nu * p->k; i++)
        if (u[i] != u[i - p->nu])
            return 0;
    return 1;
}

/* Inputs that are the same at all nodes are held. */
static int set_inputs(fmu *f) {
    return fmu_held(f, f->u) ? f->map->set_input(f->of, f->u) : f->map->set_node_inputs(f->of, f->u);
}

void fmu_parameters(fmu *f) {
    copy(f->p, f->map->parameters(f->of), f->sizes.np);
    if (f->modes)
        f->about->landing->switches->asked(f, f->p);
}

int fmu_set_parameters(fmu *f, double *p) {
    const double *energy = f->map->signals(f->of) + f->offset[PH_H];
    const int nc = f->sizes.ncomp;
    int status;
    if (f->modes)
        f->about->landing->switches->ask(f, p);
    if (!f->about->jumps || f->phase.mode != FMU_STEP)
        return f->map->set_parameters(f->of, p);
    status = f->map->refresh(f->of);
    if (status)
        return status;
    copy(f->books.before, energy, nc);
    copy(f->old, f->map->parameters(f->of), f->sizes.np);
    status = f->map->set_parameters(f->of, p);
    if (!status)
        status = f->map->refresh(f->of);
    if (status) {
        f->map->set_parameters(f->of, f->old);
        return status;
    }
    for (int c = 0; c < nc; c++)
        f->books.jumped[c] += energy[c] - f->books.before[c];
    return PH_OK;
}

int fmu_set(fmu *f, const char *function, const unsigned *ref, size_t n, const double *values) {
    const ph_sizes *plan = f ? &f->sizes : NULL;
    const fmu_impulses *impulses = f ? f->about->impulses : NULL;
    int changed[4] = {0};
    if (fmu_allow(f, function, FMU_INSTANTIATED | FMU_INITIALIZATION | FMU_STEP) ||
        fmu_given(f, function, n == 0 || (ref && values)))
        return FMU_ERROR;
    for (size_t i = 0; i < n; i++)
        if (check_set(f, function, ref[i], values[i]))
            return FMU_ERROR;
    copy(f->x, f->map->signals(f->of), plan->nx);
    copy(f->u, f->map->input(f->of), plan->nu * plan->k);
    fmu_parameters(f);
    if (impulses)
        copy(f->nodes.s, impulses->values(f->nodes.impulses), 2 * impulses->n);
    for (size_t i = 0; i < n; i++) {
        const fmu_variable *v = &f->about->variables[ref[i]];
        double *to = place_of(f, v, changed);
        for (int node = 0; node < (v->block == FMU_INPUT ? plan->k : 1); node++)
            to[node * plan->nu] = v->sign < 0 ? -values[i] : values[i];
    }
    f->end_known = 0;
    f->phase.crossed |= changed[0] && f->phase.mode == FMU_STEP;
    if ((changed[0] && fmu_set_parameters(f, f->p)) ||
        (changed[2] && f->map->set_x(f->of, fmu_time(f), f->x)) || (changed[1] && set_inputs(f)) ||
        (changed[3] && impulses->set(f->nodes.impulses, f->nodes.s)))
        return fmu_refuse(f, "%s: the values were refused", function);
    return FMU_OK;
}

int fmu_check_ranges(const fmu *f, const char *function) {
    for (int i = 0; i < f->about->nrange; i++) {
        const fmu_range *range = &f->about->ranges[i];
        if (check_range(f, function, range, value_of(f, &f->about->variables[range->variable])))
            return FMU_ERROR;
    }
    return FMU_OK;
}
