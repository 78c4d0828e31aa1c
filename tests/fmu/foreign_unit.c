/* A unit of another tool for both versions of the standard, which misbehaves on request.
 *
 * Variables: 1 `u` (input), 2 `y` = 2 u + t (output), 3 `mode` (integer: what doStep does, from time 0.25
 * on), 4 `flag` (boolean), 5 `single` (3.0: Float32), 6 `wide` (3.0: Float64[2]), 7 `choice` (enumeration), 8
 * `x` (input array [2] of 3.0).
 *
 * A mass on a spring, stepped exactly under a held force: 20 `F` (input), 21 `v`, 22 `q` (outputs), 23 `m`,
 * 24 `k` (parameters), 25 `H` (its energy).  27 `forgets` (integer): a saved state has 1: not q, 2: nothing;
 * 3: it cannot be saved.  29 `keeps` (integer), what noSetFMUStatePriorToCurrentPoint makes of a step: 1:
 * False begins at the last point that was told True, 2: False leaves it where it was, 3: after True nothing
 * is restored, 4: 2 and 3. 30 `tolerance`: of the experiment, -1: it is not defined.  28 `found`: the file
 * table.txt among its resources, whose place has to be an URI in 2.0 and a path in 3.0.  An instance with the
 * token `tool` there is not.
 *
 * A system of first order, stepped exactly under a held input: 40 `r` (input), 41 `s` = c x + d r (output),
 * 42 `x`, x' = a x + b r, 43 `a`, 44 `b`, 45 `c`, 46 `d` (parameters).
 */
#define _GNU_SOURCE
#include <fenv.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "fmi2FunctionTypes.h"
#include "fmi3FunctionTypes.h"

#pragma GCC visibility push(default)

enum {
    FINE,
    DISCARD,
    ERROR,
    FATAL,
    LEAVE,
    NOT_A_NUMBER,
    TERMINATE,
    EARLY,
    CHATTER,
    OUTPUT_ERROR,
    CRASH,
    HANG,
    LAST_WORDS,
    PRINT,
    ABORT,
    END_WITHIN,
    LEAVE_AT_ONCE,
    DEEP,
    TRAP,
    TRAPS_ON,
    ROUND = 40, /* every later number upward */
    IGNORE,     /* SIGTERM ignored, SIGHUP blocked, SIGINT taken */
    FORK        /* a copy of the process comes back too */
};

/* the time at which END_WITHIN asks to end */
static const double END = 0.33;

typedef struct unit {
    double u, t, wide[2], x[2], F, v, q, m, k, found, first[7]; /* r, -, x, a, b, c, d */
    double base[3], tolerance;
    int mode, flag, choice, said, forgets, keeps, final;
    float single;
    const fmi2CallbackFunctions *callbacks;
    fmi3LogMessageCallback log;
    void *environment;
    char name[100];
} unit;

static void say(unit *m, int status, const char *text) {
    if (m->log)
        m->log(m->environment, (fmi3Status)status, "status", text);
    else
        m->callbacks->logger(m->environment, m->name, (fmi2Status)status, "status", text);
}

static void move(unit *s, double h) {
    double w = sqrt(s->k / s->m), rest = s->k > 0.0 ? s->F / s->k : 0.0, q = s->q - rest, v = s->v;
    if (s->k > 0.0) {
        s->q = rest + q * cos(w * h) + v / w * sin(w * h);
        s->v = v * cos(w * h) - q * w * sin(w * h);
    } else {
        s->q += h * v + h * h * s->F / (2.0 * s->m);
        s->v += h * s->F / s->m;
    }
}

static void relax(double *f, double h) {
    double a = f[3], rate = a * f[2] + f[4] * f[0];
    f[2] += a == 0.0 ? h * rate : expm1(a * h) / a * rate;
}

static void from_base(unit *m) {
    m->v = m->base[0];
    m->q = m->base[1];
    m->t = m->base[2];
}

static void to_base(unit *m) {
    m->base[0] = m->v;
    m->base[1] = m->q;
    m->base[2] = m->t;
}

/* Without end, and not as a loop. */
static double deep(double x) {
    volatile double here[64];
    here[0] = x;
    return x > 0.0 ? deep(here[0] + 1.0) + here[0] : 0.0;
}

/* Whether it asks to end the simulation within a step. */
static int ends_within(const unit *m, double t, double h) {
    return m->mode == END_WITHIN && t < END - 1e-9 && t + h > END + 1e-9;
}

static void nothing(int number) {
    (void)number;
}

/* What stays with the process. */
static void spoil(int mode) {
    sigset_t blocked;
    if (mode == ROUND)
        fesetround(FE_UPWARD);
    if (mode == FORK)
        fork();
    if (mode != IGNORE)
        return;
    signal(SIGTERM, SIG_IGN);
    signal(SIGINT, nothing);
    sigemptyset(&blocked);
    sigaddset(&blocked, SIGHUP);
    sigprocmask(SIG_BLOCK, &blocked, NULL);
}

/* A library may do so as it is loaded. */
__attribute__((constructor)) static void loaded(void) {
    const char *mode = getenv("FOREIGN_UNIT_SPOILS");
    if (mode)
        spoil(atoi(mode));
}

static int step(unit *m, double t, double h, int no_set_prior) {
    static char long_text[5000];
    int mode = t >= 0.25 ? m->mode : FINE;
    if (mode >= DISCARD && mode <= FATAL) {
        say(m, 3, "first line\n\033[31mred\033[0m");
        say(m, 3, "valve stuck at 7 %");
        return mode == DISCARD ? 2 : mode == ERROR ? 3 : 4;
    }
    if (mode == LEAVE)
        exit(0);
    if (mode == TERMINATE && !m->log)
        return 2;
    if (ends_within(m, t, h)) {
        move(m, END - t);
        m->t = END;
        return m->log ? 0 : 2;
    }
    if (mode == CHATTER) {
        memset(long_text, 'x', sizeof(long_text) - 1);
        for (int i = 0; i < 1000; i++)
            say(m, 3, long_text);
        return 3;
    }
    if (mode == CRASH) {
        int *volatile nowhere = NULL;
        *nowhere = 1;
    }
    if (mode == ABORT)
        abort();
    if (mode == LEAVE_AT_ONCE)
        _exit(0);
    if (mode == DEEP)
        m->t += deep(1.0);
    if (mode == TRAP || mode == TRAPS_ON) {
        volatile double zero = 0.0;
        feenableexcept(FE_DIVBYZERO | FE_INVALID);
        if (mode == TRAP)
            m->t += 1.0 / zero;
    }
    spoil(mode);
    while (mode == HANG)
        ;
    if (mode == LAST_WORDS || mode == PRINT) {
        printf("pump speaks at %g\n", t);
        fflush(stdout);
    }
    if (mode == LAST_WORDS)
        exit(7);
    if (m->keeps == 1 && no_set_prior)
        to_base(m);
    else if (m->keeps && m->keeps != 3)
        from_base(m);
    move(m, h);
    relax(m->first, h);
    m->t = m->keeps ? m->t + h : t + h;
    if (no_set_prior && m->keeps != 1)
        to_base(m);
    m->final = no_set_prior && m->keeps > 2;
    return 0;
}

static double output(const unit *m) {
    return m->mode == NOT_A_NUMBER && m->t > 0.25 ? NAN : 2.0 * m->u + m->t;
}

static double number(const unit *m, unsigned r) {
    double H = (m->m * m->v * m->v + m->k * m->q * m->q) / 2.0;
    const double *f = m->first;
    if (r >= 40 && r < 47)
        return r == 41 ? f[5] * f[2] + f[6] * f[0] : f[r - 40];
    return r == 1    ? m->u
           : r == 20 ? m->F
           : r == 21 ? m->v
           : r == 22 ? m->q
           : r == 23 ? m->m
           : r == 24 ? m->k
           : r == 25 ? H
           : r == 28 ? m->found
           : r == 30 ? m->tolerance
                     : output(m);
}

static double has_table(const char *folder) {
    char path[2000];
    FILE *file;
    snprintf(path, sizeof(path), "%s/table.txt", folder);
    file = fopen(path, "r");
    if (file)
        fclose(file);
    return file ? 1.0 : 0.0;
}

/* The path in file:///a%20b, or nothing if a character should have been encoded. */
static double has_table_at(const char *uri) {
    char path[2000];
    size_t n = 0;
    if (!uri || strncmp(uri, "file:///", 8))
        return 0.0;
    for (const char *c = uri + 7; *c && n + 1 < sizeof(path); c++) {
        unsigned value;
        if (*c == '%' && sscanf(c + 1, "%2x", &value) == 1) {
            path[n++] = (char)value;
            c += 2;
        } else if (*c <= ' ')
            return 0.0;
        else
            path[n++] = *c;
    }
    path[n] = 0;
    return has_table(path);
}

static void set_number(unit *m, unsigned r, double value) {
    *(r >= 40 && r < 47 ? &m->first[r - 40]
      : r == 20         ? &m->F
      : r == 21         ? &m->v
      : r == 22         ? &m->q
      : r == 23         ? &m->m
      : r == 24         ? &m->k
                        : &m->u) = value;
}

static int *whole(unit *m, unsigned r) {
    return r == 3 ? &m->mode : r == 27 ? &m->forgets : r == 29 ? &m->keeps : &m->choice;
}

static int save(const unit *m, void **state) {
    if (m->forgets == 3)
        return 3;
    if (!*state)
        *state = malloc(sizeof(unit));
    memcpy(*state, m, sizeof(unit));
    return 0;
}

static int restore(unit *m, const unit *state) {
    unit now = *m;
    if (m->final)
        return 3;
    if (m->forgets < 2)
        *m = *state;
    if (m->forgets == 1)
        m->q = now.q;
    return 0;
}

static int forget(void **state) {
    free(*state);
    *state = NULL;
    return 0;
}

/* A state that may have been written by another process: what leads out of it is of this one. */
static int from_bytes(const unit *m, const void *bytes, size_t size, void **state) {
    unit *s = malloc(sizeof(unit));
    if (!s || size != sizeof(unit))
        return 3;
    memcpy(s, bytes, size);
    s->callbacks = m->callbacks;
    s->log = m->log;
    s->environment = m->environment;
    *state = s;
    return 0;
}

/* a call that has nothing to do */
#define IDLE(version, call)                                                                                  \
    version##Status version##call(void *c) {                                                                 \
        return version##OK;                                                                                  \
    }

#define STATES(version, State, Read)                                                                         \
    version##Status version##GetFMU##State(void *c, void **state) {                                          \
        return (version##Status)save(c, state);                                                              \
    }                                                                                                        \
    version##Status version##SetFMU##State(void *c, void *state) {                                           \
        return (version##Status)restore(c, state);                                                           \
    }                                                                                                        \
    version##Status version##FreeFMU##State(void *c, void **state) {                                         \
        return (version##Status)forget(state);                                                               \
    }                                                                                                        \
    version##Status version##SerializedFMU##State##Size(void *c, void *state, size_t *size) {                \
        *size = sizeof(unit);                                                                                \
        return version##OK;                                                                                  \
    }                                                                                                        \
    version##Status version##SerializeFMU##State(void *c, void *state, version##Byte to[], size_t size) {    \
        memcpy(to, state, size);                                                                             \
        return version##OK;                                                                                  \
    }                                                                                                        \
    version##Status version##Read##FMU##State(void *c, const version##Byte from[], size_t size,              \
                                              void **state) {                                                \
        return (version##Status)from_bytes(c, from, size, state);                                            \
    }

/* -- 2.0 -- */

const char *fmi2GetTypesPlatform(void) {
    return "default";
}
const char *fmi2GetVersion(void) {
    return "2.0";
}
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String k[]) {
    return fmi2OK;
}
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String place,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean on) {
    unit *m = strcmp(guid, "tool") ? calloc(1, sizeof(unit)) : NULL;
    if (!m)
        return NULL;
    m->found = has_table_at(place);
    m->callbacks = callbacks;
    m->environment = callbacks->componentEnvironment;
    m->m = 1.0;
    snprintf(m->name, sizeof(m->name), "%s", name);
    return m;
}
void fmi2FreeInstance(fmi2Component c) {
    if (((unit *)c)->mode == FATAL && ((unit *)c)->t > 0.2)
        abort(); /* nothing may be called after a fatal error */
    free(c);
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean defined, fmi2Real tolerance, fmi2Real t,
                               fmi2Boolean d, fmi2Real e) {
    ((unit *)c)->tolerance = defined ? tolerance : -1.0;
    return fmi2OK;
}
STATES(fmi2, state, DeSerialize)
IDLE(fmi2, EnterInitializationMode)
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    to_base(c);
    return fmi2OK;
}
IDLE(fmi2, Terminate)
IDLE(fmi2, Reset)
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
    unit *m = c;
    if (m->mode == OUTPUT_ERROR && m->t > 0.25)
        return fmi2Error;
    for (size_t i = 0; i < n; i++)
        v[i] = number(m, r[i]);
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) {
    for (size_t i = 0; i < n; i++)
        set_number(c, r[i], v[i]);
    return fmi2OK;
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer v[]) {
    for (size_t i = 0; i < n; i++)
        v[i] = *whole(c, r[i]);
    return fmi2OK;
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer v[]) {
    for (size_t i = 0; i < n; i++)
        *whole(c, r[i]) = v[i];
    return fmi2OK;
}
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean v[]) {
    for (size_t i = 0; i < n; i++)
        v[i] = ((unit *)c)->flag;
    return fmi2OK;
}
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[]) {
    for (size_t i = 0; i < n; i++)
        ((unit *)c)->flag = v[i];
    return fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean b) {
    return (fmi2Status)step(c, t, h, b);
}
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind k, fmi2Boolean *v) {
    *v = ((unit *)c)->mode == TERMINATE || ((unit *)c)->mode == END_WITHIN;
    return fmi2OK;
}
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind k, fmi2Real *v) {
    *v = ((unit *)c)->t;
    return fmi2OK;
}

/* -- 3.0 -- */

const char *fmi3GetVersion(void) {
    return "3.0";
}
fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String k[]) {
    return fmi3OK;
}
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path,
                                         fmi3Boolean visible, fmi3Boolean on, fmi3Boolean events,
                                         fmi3Boolean early, const fmi3ValueReference r[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    unit *m = strcmp(token, "tool") ? calloc(1, sizeof(unit)) : NULL;
    if (!m)
        return NULL;
    m->found = has_table(path);
    m->log = log;
    m->environment = environment;
    m->wide[0] = 10.0;
    m->wide[1] = 20.0;
    m->m = 1.0;
    return m;
}
void fmi3FreeInstance(fmi3Instance c) {
    fmi2FreeInstance(c);
}
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean defined, fmi3Float64 tolerance,
                                       fmi3Float64 t, fmi3Boolean d, fmi3Float64 e) {
    ((unit *)c)->tolerance = defined ? tolerance : -1.0;
    return fmi3OK;
}
STATES(fmi3, State, Deserialize)
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) {
    to_base(c);
    return fmi3OK;
}
IDLE(fmi3, Terminate)
IDLE(fmi3, Reset)
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 v[],
                          size_t nv) {
    unit *m = c;
    size_t k = 0;
    if (m->mode == OUTPUT_ERROR && m->t > 0.25)
        return fmi3Error;
    for (size_t i = 0; i < n; i++)
        if (r[i] == 6 || r[i] == 8) {
            v[k++] = r[i] == 6 ? m->wide[0] : m->x[0];
            v[k++] = r[i] == 6 ? m->wide[1] : m->x[1];
        } else
            v[k++] = number(m, r[i]);
    return k == nv ? fmi3OK : fmi3Error;
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 v[],
                          size_t nv) {
    unit *m = c;
    size_t k = 0;
    for (size_t i = 0; i < n; i++)
        if (r[i] == 8) {
            m->x[0] = v[k++];
            m->x[1] = v[k++];
        } else
            set_number(m, r[i], v[k++]);
    return k == nv ? fmi3OK : fmi3Error;
}
#define NUMBERS(Name, Type, field)                                                                           \
    fmi3Status fmi3Get##Name(fmi3Instance c, const fmi3ValueReference r[], size_t n, Type v[], size_t nv) {  \
        for (size_t i = 0; i < n; i++)                                                                       \
            v[i] = (Type)((unit *)c)->field;                                                                 \
        return fmi3OK;                                                                                       \
    }                                                                                                        \
    fmi3Status fmi3Set##Name(fmi3Instance c, const fmi3ValueReference r[], size_t n, const Type v[],         \
                             size_t nv) {                                                                    \
        for (size_t i = 0; i < n; i++)                                                                       \
            ((unit *)c)->field = v[i];                                                                       \
        return fmi3OK;                                                                                       \
    }
fmi3Status fmi3GetInt32(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Int32 v[], size_t nv) {
    for (size_t i = 0; i < n; i++)
        v[i] = *whole(c, r[i]);
    return fmi3OK;
}
fmi3Status fmi3SetInt32(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Int32 v[],
                        size_t nv) {
    for (size_t i = 0; i < n; i++)
        *whole(c, r[i]) = v[i];
    return fmi3OK;
}
NUMBERS(Int64, fmi3Int64, choice)
NUMBERS(Float32, fmi3Float32, single)
NUMBERS(Boolean, fmi3Boolean, flag)
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean b, fmi3Boolean *event,
                      fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last) {
    unit *m = c;
    int within = ends_within(m, t, h), status = step(m, t, h, b);
    *event = fmi3False;
    *end = within || (m->mode == TERMINATE && t >= 0.25);
    *early = within || (m->mode == EARLY && t >= 0.25);
    *last = m->t;
    return (fmi3Status)status;
}

/* -- what an importer looks for and never calls -- */

#define ABSENT(name)                                                                                         \
    int name(void) {                                                                                         \
        return 3;                                                                                            \
    }
ABSENT(fmi2CancelStep)

ABSENT(fmi2GetDirectionalDerivative)
ABSENT(fmi2GetIntegerStatus)
ABSENT(fmi2GetRealOutputDerivatives)
ABSENT(fmi2GetStatus)
ABSENT(fmi2GetString)
ABSENT(fmi2GetStringStatus)
ABSENT(fmi2SetRealInputDerivatives)
ABSENT(fmi2SetString) ABSENT(fmi3ActivateModelPartition) ABSENT(fmi3CompletedIntegratorStep)
    ABSENT(fmi3EnterConfigurationMode) ABSENT(fmi3EnterContinuousTimeMode) ABSENT(fmi3EnterEventMode)
        ABSENT(fmi3EnterStepMode) ABSENT(fmi3EvaluateDiscreteStates) ABSENT(fmi3ExitConfigurationMode) ABSENT(
            fmi3GetAdjointDerivative) ABSENT(fmi3GetBinary) ABSENT(fmi3GetClock)
            ABSENT(fmi3GetContinuousStateDerivatives) ABSENT(fmi3GetContinuousStates) ABSENT(
                fmi3GetDirectionalDerivative) ABSENT(fmi3GetEventIndicators) ABSENT(fmi3GetInt16)
                ABSENT(fmi3GetInt8) ABSENT(fmi3GetIntervalDecimal) ABSENT(fmi3GetIntervalFraction) ABSENT(
                    fmi3GetNominalsOfContinuousStates) ABSENT(fmi3GetNumberOfContinuousStates)
                    ABSENT(fmi3GetNumberOfEventIndicators) ABSENT(fmi3GetNumberOfVariableDependencies) ABSENT(
                        fmi3GetOutputDerivatives) ABSENT(fmi3GetShiftDecimal) ABSENT(fmi3GetShiftFraction)
                        ABSENT(fmi3GetString) ABSENT(fmi3GetUInt16) ABSENT(fmi3GetUInt32)
                            ABSENT(fmi3GetUInt64) ABSENT(fmi3GetUInt8) ABSENT(fmi3GetVariableDependencies)
                                ABSENT(fmi3InstantiateModelExchange) ABSENT(fmi3InstantiateScheduledExecution)
                                    ABSENT(fmi3SetBinary) ABSENT(fmi3SetClock) ABSENT(fmi3SetContinuousStates)
                                        ABSENT(fmi3SetInt16) ABSENT(fmi3SetInt8)
                                            ABSENT(fmi3SetIntervalDecimal) ABSENT(fmi3SetIntervalFraction)
                                                ABSENT(fmi3SetShiftDecimal) ABSENT(fmi3SetShiftFraction)
                                                    ABSENT(fmi3SetString) ABSENT(fmi3SetTime)
                                                        ABSENT(fmi3SetUInt16) ABSENT(fmi3SetUInt32)
                                                            ABSENT(fmi3SetUInt64) ABSENT(fmi3SetUInt8)
                                                                ABSENT(fmi3UpdateDiscreteStates)
