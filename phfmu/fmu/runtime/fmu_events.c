/* Events of a scene that are built into the unit: parameters that take values at given times.
 *
 * A communication step that an event lies in is taken in parts, which end at it, and told as one: energies
 * are their sums, means their means. An event at a communication point counts for the step that begins there.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmu.h"

int fmu_events_create(fmu *f) {
    if (f->about->nevent == 0 && !f->about->landing)
        return FMU_OK;
    if (f->about->landing && !f->about->landing->create(f))
        return fmu_refuse(f, "no memory for state events");
    f->kept = calloc((size_t)f->map->kept_size(f->about->of) + 1, sizeof(double));
    return f->kept ? fmu_save(f, __func__, &f->before) : FMU_ERROR;
}

void fmu_events_free(fmu *f) {
    if (f->about->landing)
        f->about->landing->release(f);
    free(f->kept);
    fmu_forget(f, &f->before);
}

/* The time of the next event, infinite for none. */
static double next_event(const fmu *f) {
    return f->phase.passed < f->about->nevent ? f->about->events[f->phase.passed].time : INFINITY;
}

/* Whether there is one left until t, which may be infinite. */
static int due(const fmu *f, double t) {
    return f->phase.passed < f->about->nevent && next_event(f) <= t;
}

int fmu_events_until(fmu *f, double t) {
    if (!due(f, t))
        return PH_OK;
    fmu_parameters(f);
    for (; due(f, t); f->phase.passed++) {
        const fmu_event *event = &f->about->events[f->phase.passed];
        f->p[f->about->variables[event->variable].first] = event->value;
    }
    return fmu_set_parameters(f, f->p);
}

static int advance(fmu *f, double t, double h, int n, int *stopped) {
    const fmu_landing *landing = f->about->landing;
    return landing ? landing->step(f, t, h, n, stopped) : f->map->step_parts(f->of, t, h, n);
}

/* A step from t by h in parts; *reached: where the last one that was solved ends; *stopped (may be NULL): at
 * a state event. */
static int step_parts(fmu *f, double t, double h, double slack, double *reached, int *stopped) {
    const double end = t + h;
    int halt = 0;
    for (*reached = t; *reached < end && !halt;) {
        const double now = *reached;
        double goal, length, part;
        int status = fmu_events_until(f, now + slack);
        if (status)
            return status;
        goal = next_event(f) < end - slack ? next_event(f) : end;
        length = now == t && goal == end ? h : goal - now; /* a whole step has no rounding of its end */
        part = ceil(length / f->about->step - FMU_SLACK);
        status = advance(f, now, length, part < 1.0 ? 1 : (int)part, stopped ? &halt : NULL);
        if (status)
            return status;
        goal = halt ? fmu_time(f) : goal;
        if (now > t)
            f->map->join(f->of, f->kept, (now - t) / (goal - t));
        f->phase.crossed |= now > t;
        f->map->keep(f->of, f->kept);
        *reached = goal;
    }
    if (stopped)
        *stopped = halt && *reached < end;
    return PH_OK;
}

int fmu_events_within(const fmu *f, double end) {
    return next_event(f) < end;
}

int fmu_events_step(fmu *f, const char *function, double t, double h, double slack, int *early) {
    double reached = t;
    const fmu_equations *rows;
    ph_report why;
    int status;
    if (!fmu_held(f, f->map->input(f->of)) || fmu_kicked(f)) {
        f->solved = next_event(f) - t;
        return fmu_say(f, FMU_DISCARD, FMU_LOG_ERRORS,
                       "%s: inputs at nodes and impulses belong to a whole step, in which there is the event "
                       "at t = %.9g s; end "
                       "a step there",
                       function, next_event(f));
    }
    if (fmu_save(f, function, &f->before))
        return FMU_ERROR;
    status = step_parts(f, t, h, slack, &reached, f->early ? early : NULL);
    if (status == PH_OK)
        return FMU_OK;
    why = *f->map->report(f->of);
    rows = fmu_refusing(f);
    if (fmu_restore(f, function, f->before))
        return FMU_ERROR;
    f->solved = reached - t;
    if (status == PH_EVENT)
        return f->about->landing->refused(f, function);
    return fmu_step_refused(f, function, FMU_DISCARD, &why, rows);
}
