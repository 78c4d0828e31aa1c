/* Calls of units of FMI 3.0. */
#include "unit.h"

#define ASK(u, name, ...)                                                                                    \
    (ph_unit_begin(u, "fmi3" #name)                                                                          \
         ? ph_unit_answer(u, ((const ph_fmi3 *)u->functions)->name(u->instance, __VA_ARGS__))                \
         : PH_REFUSED)

static int set(ph_unit *u, const ph_scalars *s) {
    return ASK(u, SetFloat64, s->reference, (size_t)s->nreference, s->value, (size_t)s->nvalue);
}

static int get(ph_unit *u, const ph_scalars *s) {
    return ASK(u, GetFloat64, s->reference, (size_t)s->nreference, s->value, (size_t)s->nvalue);
}

/* A step that ends before its end, or asks to end the simulation, is not taken. */
static int step(ph_unit *u, double t, double h) {
    bool event = false, ended = false, early = false;
    double last = t;
    int status = ASK(u, DoStep, t, h, u->no_set_prior != 0, &event, &ended, &early, &last);
    return status == PH_OK && (ended || early) ? PH_REFUSED : status;
}

static int save(ph_unit *u) {
    return ASK(u, GetFMUState, (void **)u->state);
}

static int restore(ph_unit *u) {
    return ASK(u, SetFMUState, *(void **)u->state);
}

static int derivative(ph_unit *u, const ph_scalars *unknown, const ph_scalars *known) {
    return ASK(u, GetDirectionalDerivative, unknown->reference, (size_t)unknown->nreference, known->reference,
               (size_t)known->nreference, known->value, (size_t)known->nvalue, unknown->value,
               (size_t)unknown->nvalue);
}

const ph_version *ph_unit_fmi3(void) {
    static const ph_version version = {set, get, step, save, restore, derivative};
    return &version;
}
