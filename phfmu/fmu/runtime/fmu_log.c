/* Messages: what was refused, with the numbers and the next move. */
#include <stdarg.h>
#include <stdio.h>

#include "fmu.h"

static int say(const fmu *f, int status, const char *category, const char *format, va_list values) {
    char text[1024];
    if (!f || !f->sink || !f->callback)
        return status;
    vsnprintf(text, sizeof(text), format, values);
    f->sink(f, status, category, text);
    return status;
}

int fmu_say(const fmu *f, int status, const char *category, const char *format, ...) {
    va_list values;
    va_start(values, format);
    say(f, status, category, format, values);
    va_end(values);
    return status;
}

int fmu_refuse(const fmu *f, const char *format, ...) {
    va_list values;
    va_start(values, format);
    say(f, FMU_ERROR, "logStatusError", format, values);
    va_end(values);
    return FMU_ERROR;
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

/* The last failure of the solver; the instance is back at its last accepted step. */
int fmu_solver(const fmu *f, const char *what, int status) {
    const ph_report *r = ph_last_report(f->in);
    const ph_plan *plan = r->instant ? f->about->model->instant : f->about->model->step;
    const char *const *names = r->instant ? f->about->end_equations : f->about->equations;
    int place = r->row >= 0 ? r->row : r->column;
    if (status == PH_ABI || status == PH_ARGUMENT || status == PH_VALUE || status == PH_NO_SENSITIVITY)
        return fmu_refuse(f, "%s: %s", what, ph_status_text(status)); /* these come without a report */
    return fmu_refuse(
        f,
        "%s: %s. Worst: %s, scaled residual %.3g (rounding floor %.2g), last update %.3g after %d "
        "iterations, in [%.9g s, "
        "%.9g s]. The component is back at t = %.9g s; try a smaller step, or look at its inputs",
        what, ph_status_text(status), place >= 0 && place < plan->nw ? names[place] : "none", r->residual,
        r->floor, r->update, r->iterations, r->time, r->time + r->h, fmu_time(f));
}
