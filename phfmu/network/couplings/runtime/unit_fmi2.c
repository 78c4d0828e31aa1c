/* Calls of units of FMI 2.0. */
#include "unit.h"

#define ASK(u, name, ...)                                                                                    \
    (ph_unit_begin(u, "fmi2" #name)                                                                          \
         ? ph_unit_answer(u, ((const ph_fmi2 *)u->functions)->name(u->instance, __VA_ARGS__))                \
         : PH_REFUSED)

static int set(ph_unit *u, const ph_scalars *s) {
    return ASK(u, SetReal, s->reference, (size_t)s->nreference, s->value);
}

static int get(ph_unit *u, const ph_scalars *s) {
    return ASK(u, GetReal, s->reference, (size_t)s->nreference, s->value);
}

static int step(ph_unit *u, double t, double h) {
    return ASK(u, DoStep, t, h, u->no_set_prior);
}

static int save(ph_unit *u) {
    return ASK(u, GetFMUstate, (void **)u->state);
}

static int restore(ph_unit *u) {
    return ASK(u, SetFMUstate, *(void **)u->state);
}

static int derivative(ph_unit *u, const ph_scalars *unknown, const ph_scalars *known) {
    return ASK(u, GetDirectionalDerivative, unknown->reference, (size_t)unknown->nreference, known->reference,
               (size_t)known->nreference, known->value, unknown->value);
}

const ph_version *ph_unit_fmi2(void) {
    static const ph_version version = {set, get, step, save, restore, derivative};
    return &version;
}
