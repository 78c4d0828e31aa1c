/* The life of a unit of FMI 2.0. */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "embedded.h"
#include "fmi2FunctionTypes.h"

typedef struct life {
    fmi2CallbackFunctions callbacks;
    fmi2InstantiateTYPE *Instantiate;
    fmi2FreeInstanceTYPE *FreeInstance;
    fmi2SetupExperimentTYPE *SetupExperiment;
    fmi2EnterInitializationModeTYPE *EnterInitializationMode;
    fmi2ExitInitializationModeTYPE *ExitInitializationMode;
    fmi2ResetTYPE *Reset;
    fmi2FreeFMUstateTYPE *FreeFMUstate;
    fmi2SerializedFMUstateSizeTYPE *SerializedFMUstateSize;
    fmi2SerializeFMUstateTYPE *SerializeFMUstate;
    fmi2DeSerializeFMUstateTYPE *DeSerializeFMUstate;
} life;

#define FMI "fmi2"
#define COUNT
typedef int by_reference(void *, const unsigned *, size_t, void *);
#include "embedded_calls.inc"

static void hear(fmi2ComponentEnvironment of, fmi2String name, fmi2Status status, fmi2String category,
                 fmi2String format, ...) {
    char text[512];
    va_list values;
    (void)name;
    (void)status;
    (void)category;
    if (!format)
        return;
    va_start(values, format);
    vsnprintf(text, sizeof(text), format, values);
    va_end(values);
    ph_embedded_hear(of, text);
}

static int bind(ph_embedded_unit *e) {
    life *l = calloc(1, sizeof(life));
    ph_fmi2 *f = &e->functions.two;
    int all;
    e->life = l;
    if (!l)
        return ph_embedded_refuse(e, "there is no memory");
    all = FOUND(e, l, Instantiate) && FOUND(e, l, FreeInstance) && FOUND(e, l, SetupExperiment) &&
          FOUND(e, l, EnterInitializationMode) && FOUND(e, l, ExitInitializationMode) && FOUND(e, l, Reset) &&
          FOUND(e, f, SetReal) && FOUND(e, f, GetReal) && FOUND(e, f, DoStep);
    if (e->about->saves)
        all = all && FOUND(e, f, GetFMUstate) && FOUND(e, f, SetFMUstate) && FOUND(e, l, FreeFMUstate);
    if (e->about->serialises)
        all = all && FOUND(e, l, SerializedFMUstateSize) && FOUND(e, l, SerializeFMUstate) &&
              FOUND(e, l, DeSerializeFMUstate);
    return all ? PH_OK : PH_UNIT;
}

static int begin(ph_embedded_unit *e, const char *name, const char *resources) {
    life *l = e->life;
    const fmi2CallbackFunctions callbacks = {hear, calloc, free, NULL, e};
    char *uri = ph_uri_of(resources);
    memcpy(&l->callbacks, &callbacks, sizeof(callbacks));
    e->unit.instance = uri ? l->Instantiate(name, fmi2CoSimulation, e->about->token, uri, &l->callbacks,
                                            fmi2False, fmi2False)
                           : NULL;
    free(uri);
    return e->unit.instance ? PH_OK : PH_UNIT;
}

static int enter(ph_embedded_unit *e, double start) {
    const ph_embedded_about *a = e->about;
    const int status =
        ASK(e, SetupExperiment, e->unit.instance, a->tolerance_told, a->tolerance, start, fmi2False, 0.0);
    return status ? status : ASK(e, EnterInitializationMode, e->unit.instance);
}

static void forget(ph_embedded_unit *e, void **state) {
    ASK(e, FreeFMUstate, e->unit.instance, state);
}

static int size(ph_embedded_unit *e, void *state, size_t *n) {
    return ASK(e, SerializedFMUstateSize, e->unit.instance, state, n);
}

static int write(ph_embedded_unit *e, void *state, char *bytes, size_t n) {
    return ASK(e, SerializeFMUstate, e->unit.instance, state, bytes, n);
}

static int read(ph_embedded_unit *e, const char *bytes, size_t n, void **state) {
    return ASK(e, DeSerializeFMUstate, e->unit.instance, bytes, n, state);
}

const ph_standard *ph_standard_fmi2(void) {
    static const ph_standard standard = {ph_unit_fmi2, bind,  begin, enter,  set,  find,  pass,
                                         leave,        reset, end,   forget, size, write, read};
    return &standard;
}
