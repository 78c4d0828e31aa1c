/* Messages: what was refused, with the numbers and the next move. */
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "fmu_modes.h"

double fmu_time(const fmu *f) {
    return f->map->signals(f->of)[f->sizes.nx];
}

static const struct {
    int category;
    const char *name;
} categories[] = {{FMU_LOG_ERRORS, "logStatusError"}, {FMU_LOG_HALVED, "logNonlinearSystems"}};

#define CATEGORIES (sizeof(categories) / sizeof(categories[0]))

static int say(const fmu *f, int status, int category, const char *format, va_list values) {
    char text[1024];
    if (!f || !f->sink || !f->callback || !(f->logging & category))
        return status;
    vsnprintf(text, sizeof(text), format, values);
    f->sink(f, status, categories[category == FMU_LOG_HALVED].name, text);
    return status;
}

int fmu_say(const fmu *f, int status, int category, const char *format, ...) {
    va_list values;
    va_start(values, format);
    say(f, status, category, format, values);
    va_end(values);
    return status;
}

int fmu_refuse(const fmu *f, const char *format, ...) {
    va_list values;
    va_start(values, format);
    say(f, FMU_ERROR, FMU_LOG_ERRORS, format, values);
    va_end(values);
    return FMU_ERROR;
}

int fmu_log(fmu *f, const char *function, int on, size_t n, const char *const *names) {
    int logging = n == 0 ? FMU_LOG_ALL : 0;
    if (!f)
        return FMU_ERROR;
    for (size_t i = 0; on && i < n; i++) {
        size_t c = 0;
        while (c < CATEGORIES && names && names[i] && strcmp(names[i], categories[c].name) != 0)
            c++;
        if (c == CATEGORIES || !names || !names[i])
            return fmu_refuse(f, "%s: there is no category '%s', only '%s' and '%s'", function,
                              names && names[i] ? names[i] : "", categories[0].name, categories[1].name);
        logging |= categories[c].category;
    }
    f->logging = on ? logging : 0;
    return FMU_OK;
}

static const char *mode_name(int mode) {
    switch (mode) {
    case FMU_INSTANTIATED:
        return "Instantiated";
    case FMU_INITIALIZATION:
        return "Initialization Mode";
    case FMU_STEP:
        return "Step Mode";
    default:
        return "Terminated";
    }
}

int fmu_allow(const fmu *f, const char *function, int modes) {
    if (!f)
        return FMU_ERROR;
    if (f->phase.mode & modes)
        return FMU_OK;
    return fmu_refuse(f, "%s is not allowed in the mode '%s'", function, mode_name(f->phase.mode));
}

int fmu_given(const fmu *f, const char *function, int given) {
    return given ? FMU_OK : fmu_refuse(f, "%s: a null pointer for values that are asked for", function);
}

const fmu_equations *fmu_refusing(const fmu *f) {
    return f->mode ? &f->mode->rows : &f->about->equations[f->map->part(f->of)];
}

/* A failure of the solver; the instance is at its last accepted step. */
int fmu_step_refused(const fmu *f, const char *what, int answer, const ph_report *r, const fmu_equations *e) {
    const char *const *names = r->instant ? e->instant : e->step;
    const int place = r->row >= 0 ? r->row : r->column, n = r->instant ? e->ninstant : e->nstep;
    if (r->status == PH_UNIT) /* it has told why */
        return fmu_say(f, answer, FMU_LOG_ERRORS, "%s: %s: %s in [%.9g s, %.9g s]", what, e->member,
                       ph_status_text(r->status), r->time, r->time + r->h);
    return fmu_say(
        f, answer, answer == FMU_OK ? FMU_LOG_HALVED : FMU_LOG_ERRORS,
        "%s%s: %s. Worst: %s%s%s, scaled residual %.3g (rounding floor %.2g), last update %.3g after %d "
        "iterations (%d with all attempts), in [%.9g s, %.9g s]. The component is %sat t = %.9g s; try a "
        "smaller step, or look at its inputs",
        what, answer == FMU_OK ? " returns early" : "", ph_status_text(r->status), e->member,
        *e->member ? ": " : "", place >= 0 && place < n ? names[place] : "none", r->residual, r->floor,
        r->update, r->iterations, r->spent, r->time, r->time + r->h, answer == FMU_OK ? "" : "back ",
        fmu_time(f));
}

/* The last failure of a call other than a step. */
int fmu_solver(const fmu *f, const char *what, int status) {
    if (status == PH_ABI || status == PH_ARGUMENT || status == PH_VALUE || status == PH_NO_SENSITIVITY)
        return fmu_refuse(f, "%s: %s", what, ph_status_text(status)); /* these come without a report */
    return fmu_step_refused(f, what, FMU_ERROR, f->map->report(f->of), fmu_refusing(f));
}
