/* Life of an instance: modes and steps. */
#include "fmu_modes.h"

#include <float.h>
#include <limits.h>
#include <math.h>
#include <string.h>

/* The clock of a master: n additions of a step leave up to n eps |t|. It adds at least once a step, and up to
 * TICKS times between two of ours where others step more often; UNITS are the roundings of one product or
 * sum. GAP: part of a step that is missing, not rounding, however many steps there were. */
#define UNITS 4.0
#define TICKS 1000.0
#define GAP 1e-3
#define OVERSHOOT 1e-6 /* part of the last step that may lie behind the stop time */

/* The start values set so far stay. */
int fmu_setup(fmu *f, const char *function, double start, int stop_defined, double stop) {
    if (fmu_allow(f, function, FMU_INSTANTIATED))
        return FMU_ERROR;
    if (!isfinite(start) || (stop_defined && !(stop >= start)))
        return fmu_refuse(f, "%s: start time %.9g s and stop time %.9g s do not fit", function, start, stop);
    if (f->sizes.nx > 0)
        memcpy(f->x, f->map->signals(f->of), sizeof(double) * (size_t)f->sizes.nx);
    if (f->map->set_x(f->of, start, f->x))
        return fmu_refuse(f, "%s: start time %.9g s was refused", function, start);
    f->phase.stop_defined = stop_defined;
    f->phase.start = start;
    f->phase.stop = stop;
    return FMU_OK;
}

int fmu_enter(fmu *f, const char *function) {
    if (fmu_allow(f, function, FMU_INSTANTIATED))
        return FMU_ERROR;
    f->phase.mode = FMU_INITIALIZATION;
    f->phase.happened[1] = fmu_time(f);
    return FMU_OK;
}

/* Starts that violate a hidden constraint are refused: stepped, they chatter for ever. */
static int check_starts(const fmu *f, const char *function) {
    const double *table = f->map->signals(f->of);
    const fmu_check *worst = NULL;
    double most = 1.0, value = 0.0;
    for (int i = 0; i < f->about->ncheck; i++) {
        const fmu_check *check = &f->about->checks[i];
        const fmu_variable *v = &f->about->variables[check->variable];
        double found = table[f->offset[v->block] + v->first];
        if (fabs(found) / check->limit <= most)
            continue;
        most = fabs(found) / check->limit;
        value = found;
        worst = check;
    }
    if (!worst)
        return FMU_OK;
    return fmu_refuse(
        f,
        "%s: the start values are inconsistent: %s = %.6g, allowed is +-%.3g. Choose start values of "
        "the states (and inputs) that satisfy it",
        function, f->about->variables[worst->variable].name, value, worst->limit);
}

/* From here on the ledger has to explain every change of the stored energy. */
static void open_books(fmu *f) {
    const double *energy = f->map->signals(f->of) + f->offset[PH_H];
    for (int c = 0; c < f->sizes.ncomp; c++) {
        f->books.start[c] = energy[c];
        f->books.booked[c] = f->books.rest[c] = f->books.jumped[c] = 0.0;
    }
}

/* The change of stored energy that the last step booked, compensated. */
static void book(fmu *f) {
    const double *stored = f->map->ledger(f->of, PH_ROW_STORED);
    for (int c = 0; c < f->sizes.ncomp; c++)
        ph_add(&f->books.booked[c], &f->books.rest[c], stored[c]);
}

int fmu_leave(fmu *f, const char *function) {
    int status;
    if (fmu_allow(f, function, FMU_INITIALIZATION) || fmu_check_ranges(f, function))
        return FMU_ERROR;
    status = fmu_events_until(f, f->phase.start);
    if (!status)
        status = f->map->initialise(f->of);
    if (status)
        return fmu_solver(f, function, status);
    if (check_starts(f, function))
        return FMU_ERROR;
    open_books(f);
    f->phase.mode = FMU_STEP;
    return FMU_OK;
}

int fmu_terminate(fmu *f, const char *function) {
    if (fmu_allow(f, function, FMU_STEP))
        return FMU_ERROR;
    f->phase.mode = FMU_TERMINATED;
    return FMU_OK;
}

int fmu_reset(fmu *f, const char *function) {
    const fmu_phase start = {.mode = FMU_INSTANTIATED};
    double *s;
    int n;
    if (fmu_allow(f, function, FMU_ANY))
        return FMU_ERROR;
    f->phase = start;
    f->solved = 0.0;
    f->step_known = f->end_known = f->nodes.known = 0;
    s = fmu_impulse_values(f, &n);
    for (int i = 0; i < n; i++)
        s[i] = 0.0;
    if (f->about->landing && f->about->landing->switches)
        f->about->landing->switches->reset(f);
    return f->map->reset(f->of) ? fmu_refuse(f, "%s: the start values of the model were refused", function)
                                : FMU_OK;
}

/* How far the start of an honest step of length h may be from the present time. The present time is where the
 * master said that the last step ends, so that only its own rounding is left. */
static double clock_error(const fmu *f, double t, double h) {
    const double size = fmax(fmax(fabs(t), h), fmax(fabs(f->phase.start), fabs(fmu_time(f))));
    const double unit = DBL_EPSILON * size;
    return fmax(UNITS * unit, fmin((TICKS + UNITS * f->phase.steps) * unit, GAP * h));
}

/* n internal steps of equal length, none longer than the declared one. */
static int check_step(const fmu *f, const char *function, double t, double h, int *n) {
    const double now = fmu_time(f), parts = ceil(h / f->about->step - FMU_SLACK);
    double error;
    if (!isfinite(t) || !isfinite(h) || !(h > 0.0))
        return fmu_refuse(f, "%s: a step of %.9g s from t = %.9g s; it must be positive and finite", function,
                          h, t);
    error = clock_error(f, t, h);
    if (!(fabs(t - now) <= error))
        return fmu_refuse(f,
                          "%s: the step starts at t = %.17g s, the component is at t = %.17g s; rounding "
                          "explains %.2g s. Step from where the last step ended",
                          function, t, now, error);
    if (f->phase.stop_defined && t + h > f->phase.stop + error + OVERSHOOT * h)
        return fmu_refuse(f, "%s: the step ends at t = %.17g s, after the stop time %.17g s", function, t + h,
                          f->phase.stop);
    if (parts > INT_MAX / 2)
        return fmu_refuse(f, "%s: a step of %.9g s would be %.3g internal steps of %.9g s", function, h,
                          parts, f->about->step);
    *n = parts < 1.0 ? 1 : (int)parts;
    return FMU_OK;
}

/* A step of n internal ones that was refused. Where the importer allows it, the step ends at the last of them
 * that was solved, as a step of that length: a communication point there lets the importer change inputs, or
 * the length of its steps. It is no error; where the rest cannot be solved, the next call discards. Inputs at
 * nodes and impulses belong to the whole step, so that it cannot end early. */
static int refuse_step(fmu *f, const char *function, double t, double h, int n, int *early) {
    const ph_report why = *f->map->report(f->of);
    const fmu_equations *rows = fmu_refusing(f);
    const double part = h * why.solved / n;
    if (f->map->returns && !f->map->returns(f->about->of))
        return fmu_step_refused(f, function, FMU_ERROR, &why, rows);
    if (f->early && early && why.solved > 0 && fmu_held(f, f->map->input(f->of)) && !fmu_kicked(f) &&
        f->map->step_parts(f->of, t, part, why.solved) == PH_OK) {
        *early = 1;
        return fmu_step_refused(f, function, FMU_OK, &why, rows);
    }
    f->solved = part;
    return fmu_step_refused(f, function, FMU_DISCARD, &why, rows);
}

/* In a step too short to be one time moves, and impulses act, which make a state consistent. */
static int step_parts(fmu *f, double t, double h, int n) {
    const fmu_impulses *impulses = f->about->impulses;
    if (h <= PH_SLIVER_STEP * f->about->step)
        return fmu_kicked(f) ? impulses->kick(f->nodes.impulses, t + h) : f->map->skip(f->of, t + h);
    return impulses ? impulses->step(f->nodes.impulses, t, h, n) : f->map->step_parts(f->of, t, h, n);
}

static int solve_step(fmu *f, const char *function, double t, double h, int n, int *early) {
    const double slack = clock_error(f, t, h);
    const int sliver = h <= PH_SLIVER_STEP * f->about->step;
    int status = fmu_events_until(f, t + slack);
    if (!status && (fmu_events_within(f, t + h - slack) || (f->about->landing && !sliver)))
        return fmu_events_step(f, function, t, h, slack, early);
    if (!status)
        status = step_parts(f, t, h, n);
    if (status == PH_ARGUMENT)
        return fmu_solver(f, function, status);
    return status ? refuse_step(f, function, t, h, n, early) : FMU_OK;
}

/* What a step from here depends on: states, inputs, parameters, impulses. */
static unsigned long long begun_with(fmu *f) {
    const ph_sizes *plan = &f->sizes;
    int n;
    const double *s = fmu_impulse_values(f, &n);
    unsigned long long hash = fmu_hash(FMU_HASHED, f->map->signals(f->of), sizeof(double) * (size_t)plan->nx);
    hash = fmu_hash(hash, f->map->input(f->of), sizeof(double) * (size_t)(plan->nu * plan->k));
    fmu_parameters(f);
    hash = fmu_hash(hash, f->p, sizeof(double) * (size_t)plan->np);
    return n > 0 ? fmu_hash(hash, s, sizeof(double) * (size_t)n) : hash;
}

/* A step was discarded. Asked for again as it was, or a longer one, it can never succeed: importers that
 * take a discard for a pause would ask for ever, so that it is an error from then on. */
static int discard(fmu *f, const char *function, double t, double h) {
    const fmu_discarded now = {t, h, begun_with(f)}, last = f->discarded;
    f->discarded = now;
    if (!(last.h > 0.0) || last.t != t || h < last.h || last.from != now.from)
        return FMU_DISCARD;
    return fmu_refuse(f,
                      "%s: the step from t = %.9g s was discarded before, with the same inputs and a length "
                      "of %.9g s; so is this one of %.9g s. Take a smaller step, set other inputs, or end",
                      function, t, last.h, h);
}

int fmu_do_step(fmu *f, const char *function, double t, double h, int *early) {
    const long long *count;
    long long halved;
    int status, n = 0;
    if (early)
        *early = 0;
    if (fmu_allow(f, function, FMU_STEP) || check_step(f, function, t, h, &n))
        return FMU_ERROR;
    count = f->map->counts(f->of);
    halved = count[PH_SUBSTEPS];
    f->step_known = f->end_known = f->nodes.known = 0;
    f->solved = 0.0;
    f->phase.crossed = 0;
    status = solve_step(f, function, t, h, n, early);
    if (status)
        return status == FMU_DISCARD ? discard(f, function, t, h) : status;
    f->phase.steps++;
    book(f);
    if (count[PH_SUBSTEPS] > halved)
        fmu_say(f, FMU_OK, FMU_LOG_HALVED, "the step from t = %.9g s of %.9g s was halved %lld times", t, h,
                count[PH_SUBSTEPS] - halved);
    return FMU_OK;
}
