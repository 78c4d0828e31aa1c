/* A unit of FMI 2.0 that lies on request: a mass on a spring, stepped exactly under a held force.
 *
 * 1 `F` (input), 2 `v`, 3 `q` (outputs), 4 `m`, 5 `k` (parameters), 6 `lie` (integer parameter). */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"

#pragma GCC visibility push(default)

#define LATE 0.25 /* s, when some lies begin */
#define WRONG 1e-3

enum { HONEST, FORGETS, NOT_A_NUMBER, CHANCE, CHANCE_LATE, DRIFTS, DERIVATIVES };

typedef struct unit {
    double t, F, v, q, m, k;
    int lie;
} unit;

/* What an honest unit does not have: memory beside its state. */
static int calls, reads;

static double number(const unit *s, unsigned r) {
    if (r == 2 && s->lie == NOT_A_NUMBER && s->t > LATE)
        return NAN;
    if (r == 2)
        return s->v + (s->lie == DRIFTS ? WRONG * (double)(reads++ % 7) : 0.0);
    return r == 1 ? s->F : r == 3 ? s->q : r == 4 ? s->m : s->k;
}

static void step(unit *s, double t, double h) {
    const int chance = s->lie == CHANCE || (s->lie == CHANCE_LATE && t >= LATE);
    const double F = chance ? s->F * (1.0 + WRONG * (double)(calls++ % 7)) : s->F;
    const double w = sqrt(s->k / s->m), rest = s->k > 0.0 ? F / s->k : 0.0, q = s->q - rest, v = s->v;
    if (s->k > 0.0) {
        s->q = rest + q * cos(w * h) + v / w * sin(w * h);
        s->v = v * cos(w * h) - q * w * sin(w * h);
    } else {
        s->q += h * v + h * h * F / (2.0 * s->m);
        s->v += h * F / s->m;
    }
    s->t = t + h;
}

const char *fmi2GetTypesPlatform(void) {
    return "default";
}
const char *fmi2GetVersion(void) {
    return "2.0";
}
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String place,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean on) {
    unit *s = calloc(1, sizeof(unit));
    if (s)
        s->m = 1.0;
    return s;
}
void fmi2FreeInstance(fmi2Component c) {
    free(c);
}
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[]) {
    for (size_t i = 0; i < n; i++)
        value[i] = number(c, r[i]);
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real value[]) {
    unit *s = c;
    for (size_t i = 0; i < n; i++)
        *(r[i] == 1 ? &s->F : r[i] == 3 ? &s->q : r[i] == 4 ? &s->m : r[i] == 5 ? &s->k : &s->v) = value[i];
    return fmi2OK;
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer value[]) {
    for (size_t i = 0; i < n; i++)
        value[i] = ((unit *)c)->lie;
    return fmi2OK;
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n,
                          const fmi2Integer value[]) {
    for (size_t i = 0; i < n; i++)
        ((unit *)c)->lie = value[i];
    return fmi2OK;
}
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (!*state)
        *state = malloc(sizeof(unit));
    if (!*state)
        return fmi2Error;
    memcpy(*state, c, sizeof(unit));
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    unit *s = c;
    const double q = s->q;
    *s = *(const unit *)state;
    if (s->lie == FORGETS)
        s->q = q;
    return fmi2OK;
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    free(*state);
    *state = NULL;
    return fmi2OK;
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t nu,
                                        const fmi2ValueReference known[], size_t nk, const fmi2Real seed[],
                                        fmi2Real value[]) {
    for (size_t i = 0; i < nu; i++)
        value[i] = -7.0;
    return fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean kept) {
    step(c, t, h);
    return fmi2OK;
}

/* Calls that have nothing to do, and those that an importer looks for and never makes. */
#define ANSWER(name, status)                                                                                 \
    fmi2Status name(void) {                                                                                  \
        return status;                                                                                       \
    }
ANSWER(fmi2SetDebugLogging, fmi2OK)
ANSWER(fmi2SetupExperiment, fmi2OK)
ANSWER(fmi2EnterInitializationMode, fmi2OK)
ANSWER(fmi2ExitInitializationMode, fmi2OK)
ANSWER(fmi2Terminate, fmi2OK)
ANSWER(fmi2Reset, fmi2OK)
ANSWER(fmi2GetBoolean, fmi2Error)
ANSWER(fmi2SetBoolean, fmi2Error)
ANSWER(fmi2GetString, fmi2Error)
ANSWER(fmi2SetString, fmi2Error)
ANSWER(fmi2SerializedFMUstateSize, fmi2Error)
ANSWER(fmi2SerializeFMUstate, fmi2Error)
ANSWER(fmi2DeSerializeFMUstate, fmi2Error)
ANSWER(fmi2SetRealInputDerivatives, fmi2Error)
ANSWER(fmi2GetRealOutputDerivatives, fmi2Error)
ANSWER(fmi2CancelStep, fmi2Error)
ANSWER(fmi2GetStatus, fmi2Error)
ANSWER(fmi2GetRealStatus, fmi2Error)
ANSWER(fmi2GetIntegerStatus, fmi2Error)
ANSWER(fmi2GetBooleanStatus, fmi2Error)
ANSWER(fmi2GetStringStatus, fmi2Error)
