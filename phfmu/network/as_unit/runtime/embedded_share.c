/* A unit of another tool as a share of the master: called_share.py, fmu_member.py and the estimate of
 * unit_books.py in C, with the same calls in the same order. */
#include <fenv.h>
#include <math.h>
#include <string.h>

#include "embedded.h"
#include "system.h"

static double sum(const double *values, int n) {
    double found = 0.0;
    for (int i = 0; i < n; i++)
        found += values[i];
    return found;
}

/* Energy that the held inputs supplied in a step of length h, by the change of what the outputs are the rates
 * of, else by the trapezoid of the outputs, or by Radau's rule of a step in parts; `after`: at its end. */
static void book(ph_embedded_unit *e, double h, const double *after) {
    const ph_embedded_about *a = e->about;
    double *mean = e->table + e->offset[PH_Y_STEP], *through = e->table + e->offset[PH_ENERGY];
    double *pair = e->row[PH_ROW_PAIRS], supplied;
    for (int i = 0; i < a->nu; i++) {
        const int q = a->rate[i];
        mean[i] = a->in_parts ? 0.75 * e->third[i] + 0.25 * after[i] : (e->after[i] + after[i]) / 2.0;
        if (q >= 0 && h != 0.0)
            mean[i] = (after[q] - e->after[q]) / h;
        pair[i] = h * (a->input.sign[i] * e->given[i]) * mean[i];
    }
    memcpy(e->after, after, sizeof(double) * (size_t)a->nlooked);
    for (int i = 0; i < a->nu; i++)
        through[i] = e->supplied[i] += pair[i];
    supplied = sum(pair, a->nu);
    *e->row[PH_ROW_STORED] = *e->row[PH_ROW_SUPPLIED] = supplied;
    *e->row[PH_ROW_MOVED] = fabs(sum(e->supplied, a->nu));
    e->table[e->offset[PH_SUPPLIED]] = e->table[e->offset[PH_H]] = sum(e->supplied, a->nu);
}

static int keep(const ph_share *s) {
    ph_embedded_unit *e = s->of;
    memcpy(e->kept, e->values, sizeof(double) * (size_t)e->nvalue);
    e->moved = 0;
    return e->about->saves ? ph_embedded_asked(e, e->unit.version->save(&e->unit)) : PH_OK;
}

static int back(ph_embedded_unit *e) {
    int status = PH_OK;
    if (e->about->saves)
        status = ph_embedded_asked(e, e->unit.version->restore(&e->unit));
    else
        e->lost = e->lost || e->moved;
    memcpy(e->values, e->kept, sizeof(double) * (size_t)e->nvalue);
    e->moved = 0;
    return status;
}

static int restore(const ph_share *s) {
    return back(s->of);
}

/* The step itself, in two parts where that is asked for. */
static int over(ph_embedded_unit *e, double t, double h) {
    const double third = t + h / 3;
    int status;
    if (!e->about->in_parts)
        return ph_embedded_asked(e, e->unit.version->step(&e->unit, t, h));
    status = ph_embedded_asked(e, e->unit.version->step(&e->unit, t, third - t));
    if (status == PH_OK)
        status = ph_embedded_look(e, e->third);
    return status ? status : ph_embedded_asked(e, e->unit.version->step(&e->unit, third, t + h - third));
}

/* Under the inputs that it has. */
static int advance(ph_embedded_unit *e, double t, double h) {
    double *looked = e->now;
    fenv_t arithmetic;
    int status;
    if (e->lost)
        return ph_embedded_refuse(e, "it was refused a step before and cannot save its state: start again");
    status = ph_embedded_look(e, e->after);
    if (status)
        return status;
    e->moved = 1;
    fegetenv(&arithmetic);
    status = over(e, t, h);
    fesetenv(&arithmetic);
    if (status == PH_OK)
        status = ph_embedded_look(e, looked);
    for (int i = 0; i < e->about->nlooked && status == PH_OK; i++)
        if (!isfinite(looked[i]))
            return ph_embedded_refuse(e, "an output of its ports is not finite at t = %.9g s", t + h);
    if (status)
        return status;
    e->table[e->offset[PH_TIME]] = t + h;
    *e->h = h;
    book(e, h, looked);
    return PH_OK;
}

static int step(const ph_share *s, double t, double h) {
    ph_embedded_unit *e = s->of;
    int status;
    e->report = (ph_report){.status = PH_UNIT, .row = -1, .column = -1, .time = t, .h = h};
    e->unit.time = t;
    e->unit.length = h;
    status = ph_embedded_set_input(e, s->u);
    return status ? status : advance(e, t, h);
}

int ph_embedded_finish(void *of) {
    ph_embedded_unit *e = of;
    const size_t inputs = sizeof(double) * (size_t)e->about->nu;
    int status;
    memcpy(e->again, e->given, inputs);
    status = back(e);
    memcpy(e->given, e->again, inputs);
    if (status == PH_OK)
        status = ph_embedded_give(e);
    e->unit.no_set_prior = 1;
    if (status == PH_OK)
        status = advance(e, e->unit.time, e->unit.length);
    e->unit.no_set_prior = e->about->no_set_prior;
    return status;
}

static int refresh(const ph_share *s) {
    return ph_embedded_look_now(s->of);
}

static int none(const ph_share *s) {
    (void)s;
    return PH_OK;
}

static int along(const ph_share *s) {
    (void)s;
    return PH_NO_SENSITIVITY;
}

static int present(const ph_share *s) {
    return ph_embedded_set_input(s->of, s->now);
}

static int record(const ph_share *s, double *to) {
    ph_embedded_unit *e = s->of;
    const int status = ph_embedded_refresh(e);
    (void)to;
    for (int i = 0; i < e->about->nwatched && status == PH_OK; i++)
        if (!isfinite(e->table[e->offset[PH_OBSERVABLES] + e->about->watched[i]]))
            return ph_embedded_refuse(e, "an output is not finite at t = %.9g s",
                                      e->table[e->offset[PH_TIME]]);
    return status;
}

static int tell(const ph_share *s) {
    return ph_embedded_tell(s->of, s->told);
}

static int take(const ph_share *s) {
    return ph_embedded_take(s->of, s->taken);
}

/* It takes no impulses. */
const ph_kind *ph_kind_embedded(void) {
    static const ph_kind kind = {keep,  restore, step,   refresh, none, none,
                                 along, present, record, tell,    take, NULL};
    return &kind;
}
