/* A mass on a spring with a damper as a unit of another tool, FMI 2.0 and 3.0, with one planted defect.
 *
 * m v' = F - k q - d v by the implicit midpoint rule under a held force F.  Variables: 1 F (input), 2 v, 3 q,
 * 4 a = (F - k q - d v) / m (outputs), 5 m, 6 k, 7 d (parameters), 8 w (an output that follows nothing at
 * once).  DEFECT is one of the names below; 0: there is none.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "fmi2FunctionTypes.h"
#include "fmi3FunctionTypes.h"

#pragma GCC visibility push(default)

#define NONE 0
#define FORGETS 1          /* a restored state lacks the position */
#define BYTES 2            /* a state of bytes lacks the velocity */
#define SHARED 3           /* all instances have one position */
#define PROCESS 4          /* values depend on the number of the process */
#define READ_MOVES 5       /* reading an output changes it */
#define RESET_KEEPS 6      /* a reset leaves the velocity */
#define DERIVATIVE 7       /* a directional derivative of the wrong size */
#define ADJOINT 8          /* an adjoint derivative of the wrong sign */
#define NOT_FINITE 9       /* not a number with OK */
#define GROWS 10           /* 1e120 with OK */
#define FOLLOWS 11         /* an output that follows the input at once, which its dependencies deny */
#define LEAKS 12           /* 64 bytes a step */
#define LEAVES_FILE 13     /* a file in the working folder */
#define LEAVES_HANDLE 14   /* an open file */
#define NEGATIVE_DAMPER 15 /* power out of nothing */
#define DIVERGES 16        /* an error that grows as the step shrinks */
#define START 17           /* a start value that is not the declared one */
#define PARAMETER 18       /* a parameter that is not kept */
#define HANGS 19           /* no answer after a state was restored */
#define EARLY 20           /* an early return that is not declared */
#define THREADS 21         /* scratch memory that threads share */
#define UNEQUAL 22         /* a step of another length than the first is refused */
#define REFUSES 23         /* a step of its own experiment is refused */
#define CRASHES 24         /* memory that is not its own, as bytes are made of a state */
#define RANDOM 25          /* values that no two runs share */

typedef struct unit {
    double t, F, q, v, m, k, d, w, first;
    int restored;
} unit;

static double shared, scratch;
static void *volatile lost;

static void begin(unit *s) {
    double v = s->v;
    memset(s, 0, sizeof(unit));
    s->m = DEFECT == START ? 2.0 : 1.0;
    s->k = 40.0;
    s->d = DEFECT == NEGATIVE_DAMPER ? -0.5 : 0.5;
    s->q = 0.0;
    shared = s->q;
    if (DEFECT == RESET_KEEPS)
        s->v = v;
}

static double acceleration(const unit *s) {
    return (s->F - s->k * s->q - s->d * s->v) / s->m;
}

static void move(unit *s, double h) {
    double *q = DEFECT == SHARED ? &shared : &s->q, c = 0.5 * h;
    double v =
        (s->v * (s->m - c * s->d - c * c * s->k) + h * (s->F - s->k * *q)) / (s->m + c * s->d + c * c * s->k);
    *q += c * (s->v + v);
    s->v = v;
    s->w = s->w * exp(-h) + h * s->F;
}

static int step(unit *s, double t, double h) {
    if (DEFECT == HANGS && s->restored)
        for (volatile int on = 1; on;)
            usleep(1000);
    if (DEFECT == REFUSES && t > 0.2)
        return 3;
    if (DEFECT == UNEQUAL && s->first > 0.0 && fabs(h - s->first) > 1e-9)
        return 3;
    if (s->first == 0.0)
        s->first = h;
    move(s, h);
    s->t = t + h;
    if (DEFECT == PROCESS)
        s->w += 1e-9 * getpid();
    if (DEFECT == RANDOM)
        s->w += 1e-9 * (double)(random() % 1000);
    if (DEFECT == LEAKS)
        lost = malloc(64);
    if (DEFECT == NOT_FINITE && s->t > 0.3)
        s->w = NAN;
    if (DEFECT == GROWS && s->t > 0.3)
        s->w = 1e120;
    if (DEFECT == DIVERGES)
        s->w += 1e-12 * pow(0.01 / h, 40.0);
    if (DEFECT == LEAVES_FILE) {
        FILE *file = fopen("trace.txt", "a");
        if (file)
            fclose(file);
    }
    if (DEFECT == LEAVES_HANDLE && open("/dev/null", O_RDONLY) < 0)
        return 3;
    if (DEFECT == THREADS) {
        scratch = s->F;
        usleep(300);
        s->w += scratch;
    }
    return 0;
}

static double number(unit *s, unsigned reference) {
    switch (reference) {
    case 1:
        return s->F;
    case 2:
        return s->v;
    case 3:
        return DEFECT == SHARED ? shared : s->q;
    case 4:
        return acceleration(s);
    case 5:
        return s->m;
    case 6:
        return s->k;
    case 7:
        return s->d;
    default:
        if (DEFECT == READ_MOVES)
            s->w += 1e-6;
        return s->w + (DEFECT == FOLLOWS ? s->F : 0.0);
    }
}

static void set_number(unit *s, unsigned reference, double value) {
    switch (reference) {
    case 1:
        s->F = value;
        break;
    case 5:
        s->m = value;
        break;
    case 6:
        s->k = DEFECT == PARAMETER ? 40.0 : value;
        break;
    case 7:
        s->d = value;
    }
}

static void restore(unit *s, const unit *state) {
    double q = s->q;
    *s = *state;
    s->restored = 1;
    if (DEFECT == FORGETS)
        s->q = q;
}

static void to_bytes(const unit *state, char *bytes) {
    unit copy = *state;
    if (DEFECT == CRASHES)
        *(volatile int *)NULL = 1;
    if (DEFECT == BYTES)
        copy.v = 0.0;
    memcpy(bytes, &copy, sizeof(unit));
}

/* d of output `y` / d F */
static double slope(const unit *s, unsigned y) {
    return y == 4 ? (DEFECT == DERIVATIVE ? 2.0 : 1.0) / s->m : 0.0;
}

/* a call that has nothing to do */
#define IDLE(version, call)                                                                                  \
    version##Status version##call(void *c) {                                                                 \
        return version##OK;                                                                                  \
    }
/* calls that both versions have */
#define STATES(version, State, Serialized, Serialize, Deserialize, byte)                                     \
    version##Status version##Reset(void *c) {                                                                \
        begin(c);                                                                                            \
        return version##OK;                                                                                  \
    }                                                                                                        \
    version##Status version##GetFMU##State(void *c, void **state) {                                          \
        if (!*state)                                                                                         \
            *state = malloc(sizeof(unit));                                                                   \
        memcpy(*state, c, sizeof(unit));                                                                     \
        return version##OK;                                                                                  \
    }                                                                                                        \
    version##Status version##SetFMU##State(void *c, void *state) {                                           \
        restore(c, state);                                                                                   \
        return version##OK;                                                                                  \
    }                                                                                                        \
    version##Status version##FreeFMU##State(void *c, void **state) {                                         \
        free(*state);                                                                                        \
        *state = NULL;                                                                                       \
        return version##OK;                                                                                  \
    }                                                                                                        \
    version##Status version##Serialized(void *c, void *state, size_t *size) {                                \
        *size = sizeof(unit);                                                                                \
        return version##OK;                                                                                  \
    }                                                                                                        \
    version##Status version##Serialize(void *c, void *state, byte bytes[], size_t size) {                    \
        to_bytes(state, (char *)bytes);                                                                      \
        return version##OK;                                                                                  \
    }                                                                                                        \
    version##Status version##Deserialize(void *c, const byte bytes[], size_t size, void **state) {           \
        if (!*state)                                                                                         \
            *state = malloc(sizeof(unit));                                                                   \
        memcpy(*state, bytes, sizeof(unit));                                                                 \
        return version##OK;                                                                                  \
    }

/* -- 2.0 -- */

const char *fmi2GetTypesPlatform(void) {
    return "default";
}
const char *fmi2GetVersion(void) {
    return "2.0";
}
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String place,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean on) {
    unit *s = calloc(1, sizeof(unit));
    begin(s);
    return s;
}
void fmi2FreeInstance(fmi2Component c) {
    free(c);
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean defined, fmi2Real tolerance, fmi2Real t,
                               fmi2Boolean d, fmi2Real e) {
    return fmi2OK;
}
IDLE(fmi2, EnterInitializationMode)
IDLE(fmi2, ExitInitializationMode)
IDLE(fmi2, Terminate)
STATES(fmi2, state, SerializedFMUstateSize, SerializeFMUstate, DeSerializeFMUstate, fmi2Byte)
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
    for (size_t i = 0; i < n; i++)
        v[i] = number(c, r[i]);
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) {
    for (size_t i = 0; i < n; i++)
        set_number(c, r[i], v[i]);
    return fmi2OK;
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t nu,
                                        const fmi2ValueReference known[], size_t nk, const fmi2Real seed[],
                                        fmi2Real v[]) {
    for (size_t i = 0; i < nu; i++)
        v[i] = slope(c, unknown[i]) * seed[0];
    return fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean b) {
    return (fmi2Status)step(c, t, h);
}

/* -- 3.0 -- */

const char *fmi3GetVersion(void) {
    return "3.0";
}
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path,
                                         fmi3Boolean visible, fmi3Boolean on, fmi3Boolean events,
                                         fmi3Boolean early, const fmi3ValueReference r[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    unit *s = calloc(1, sizeof(unit));
    begin(s);
    return s;
}
void fmi3FreeInstance(fmi3Instance c) {
    free(c);
}
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean defined, fmi3Float64 tolerance,
                                       fmi3Float64 t, fmi3Boolean d, fmi3Float64 e) {
    return fmi3OK;
}
IDLE(fmi3, ExitInitializationMode)
IDLE(fmi3, Terminate)
STATES(fmi3, State, SerializedFMUStateSize, SerializeFMUState, DeserializeFMUState, fmi3Byte)
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 v[],
                          size_t nv) {
    return (fmi3Status)fmi2GetReal(c, r, n, v);
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 v[],
                          size_t nv) {
    return (fmi3Status)fmi2SetReal(c, r, n, v);
}
fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknown[], size_t nu,
                                        const fmi3ValueReference known[], size_t nk, const fmi3Float64 seed[],
                                        size_t ns, fmi3Float64 v[], size_t nv) {
    return (fmi3Status)fmi2GetDirectionalDerivative(c, unknown, nu, known, nk, seed, v);
}
fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknown[], size_t nu,
                                    const fmi3ValueReference known[], size_t nk, const fmi3Float64 seed[],
                                    size_t ns, fmi3Float64 v[], size_t nv) {
    v[0] = 0.0;
    for (size_t i = 0; i < nu; i++)
        v[0] += (DEFECT == ADJOINT ? -1.0 : 1.0) * slope(c, unknown[i]) * seed[i];
    return fmi3OK;
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean b, fmi3Boolean *event,
                      fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last) {
    int stops = DEFECT == EARLY && t > 0.1, status = step(c, t, stops ? 0.5 * h : h);
    *event = *end = fmi3False;
    *early = stops;
    *last = ((unit *)c)->t;
    return (fmi3Status)status;
}
