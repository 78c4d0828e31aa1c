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

#define FOUND(e, of, name) ph_embedded_function(e, "fmi3" #name, &(of)->name, sizeof((of)->name))
#define ASK(e, name, ...)                                                                                    \
    (ph_unit_begin(&(e)->unit, "fmi3" #name)                                                                 \
         ? ph_unit_answer(&(e)->unit, (int)((life *)(e)->life)->name(__VA_ARGS__))                           \
         : PH_REFUSED)

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

/* One value, of any type: its functions differ in that alone. */
static int set(ph_embedded_unit *e, const ph_typed *start) {
    int (*call)(void *, const unsigned *, size_t, const void *, size_t);
    char name[32];
    snprintf(name, sizeof(name), "fmi3%s", start->function);
    if (!ph_embedded_function(e, name, &call, sizeof(call)) || !ph_unit_begin(&e->unit, start->function))
        return PH_REFUSED;
    return ph_unit_answer(&e->unit, call(e->unit.instance, &start->reference, 1, start->value, 1));
}

static int find(ph_embedded_unit *e, const ph_typed *told, ph_reader *to) {
    char name[32];
    snprintf(name, sizeof(name), "fmi3%s", told->function);
    return ph_embedded_function(e, name, to, sizeof(*to)) ? PH_OK : PH_UNIT;
}

static int get(ph_embedded_unit *e, const ph_typed *told, ph_reader by, void *value) {
    int (*call)(void *, const unsigned *, size_t, void *, size_t) =
        (int (*)(void *, const unsigned *, size_t, void *, size_t))by;
    if (!ph_unit_begin(&e->unit, told->function))
        return PH_REFUSED;
    return ph_unit_answer(&e->unit, call(e->unit.instance, &told->reference, 1, value, 1));
}

static int leave(ph_embedded_unit *e) {
    return ASK(e, ExitInitializationMode, e->unit.instance);
}

static int reset(ph_embedded_unit *e) {
    return ASK(e, Reset, e->unit.instance);
}

static void end(ph_embedded_unit *e) {
    ((life *)e->life)->FreeInstance(e->unit.instance);
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
    static const ph_standard standard = {ph_unit_fmi3, bind,  begin, enter,  set,  find,  get,
                                         leave,        reset, end,   forget, size, write, read};
    return &standard;
}
