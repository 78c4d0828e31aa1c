/* The life of a unit of FMI 3.0: without an Event Mode, and without early return. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "embedded.h"
#include "fmi3FunctionTypes.h"

typedef struct life {
    fmi3InstantiateCoSimulationTYPE *InstantiateCoSimulation;
    fmi3FreeInstanceTYPE *FreeInstance;
    fmi3EnterInitializationModeTYPE *EnterInitializationMode;
    fmi3ExitInitializationModeTYPE *ExitInitializationMode;
    fmi3ResetTYPE *Reset;
    fmi3FreeFMUStateTYPE *FreeFMUState;
    fmi3SerializedFMUStateSizeTYPE *SerializedFMUStateSize;
    fmi3SerializeFMUStateTYPE *SerializeFMUState;
    fmi3DeserializeFMUStateTYPE *DeserializeFMUState;
} life;

#define FMI "fmi3"
#define COUNT , 1
typedef int by_reference(void *, const unsigned *, size_t, void *, size_t);
#include "embedded_calls.inc"

static void hear(fmi3InstanceEnvironment of, fmi3Status status, fmi3String category, fmi3String text) {
    (void)status;
    (void)category;
    ph_embedded_hear(of, text);
}

static int bind(ph_embedded_unit *e) {
    life *l = calloc(1, sizeof(life));
    ph_fmi3 *f = &e->functions.three;
    int all;
    e->life = l;
    if (!l)
        return ph_embedded_refuse(e, "there is no memory");
    all = FOUND(e, l, InstantiateCoSimulation) && FOUND(e, l, FreeInstance) &&
          FOUND(e, l, EnterInitializationMode) && FOUND(e, l, ExitInitializationMode) && FOUND(e, l, Reset) &&
          FOUND(e, f, SetFloat64) && FOUND(e, f, GetFloat64) && FOUND(e, f, DoStep);
    if (e->about->saves)
        all = all && FOUND(e, f, GetFMUState) && FOUND(e, f, SetFMUState) && FOUND(e, l, FreeFMUState);
    if (e->about->serialises)
        all = all && FOUND(e, l, SerializedFMUStateSize) && FOUND(e, l, SerializeFMUState) &&
              FOUND(e, l, DeserializeFMUState);
    return all ? PH_OK : PH_UNIT;
}

/* The folder ends with a separator. */
static int begin(ph_embedded_unit *e, const char *name, const char *resources) {
    char *path = malloc(strlen(resources) + 2);
    if (path)
        sprintf(path, "%s/", resources);
    e->unit.instance = path ? ((life *)e->life)
                                  ->InstantiateCoSimulation(name, e->about->token, path, false, false, false,
                                                            false, NULL, 0, e, hear, NULL)
                            : NULL;
    free(path);
    return e->unit.instance ? PH_OK : PH_UNIT;
}

static int enter(ph_embedded_unit *e, double start) {
    const ph_embedded_about *a = e->about;
    return ASK(e, EnterInitializationMode, e->unit.instance, a->tolerance_told, a->tolerance, start, false,
               0.0);
}

static void forget(ph_embedded_unit *e, void **state) {
    ASK(e, FreeFMUState, e->unit.instance, state);
}

static int size(ph_embedded_unit *e, void *state, size_t *n) {
    return ASK(e, SerializedFMUStateSize, e->unit.instance, state, n);
}

static int write(ph_embedded_unit *e, void *state, char *bytes, size_t n) {
    return ASK(e, SerializeFMUState, e->unit.instance, state, (fmi3Byte *)bytes, n);
}

static int read(ph_embedded_unit *e, const char *bytes, size_t n, void **state) {
    return ASK(e, DeserializeFMUState, e->unit.instance, (const fmi3Byte *)bytes, n, state);
}

const ph_standard *ph_standard_fmi3(void) {
    static const ph_standard standard = {ph_unit_fmi3, bind,  begin, enter,  set,  find,  pass,
                                         leave,        reset, end,   forget, size, write, read};
    return &standard;
}
