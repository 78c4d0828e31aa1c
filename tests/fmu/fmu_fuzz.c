/* A host that keeps to no rule: calls of random functions in random order with random arguments, on units of
 * one version compiled into it together with sanitizers.
 *
 *     fmu_fuzz TOKEN CALLS SEED STEP NVARIABLE LIVELY
 *
 * Of LIVELY+1 calls LIVELY are those of a simulation: steps from where the last one ended, mostly of a usual
 * length, inputs and parameters of usual sizes, states saved and restored; the others are any.
 * Pointers are valid, or NULL where C allows a call to find out; everything else may be wrong. Prints how
 * often each function was called and was refused. Exit code 1: a value was read that is not finite, although
 * the call said OK; 2: a call that must fail did not. -DFMI=2 or 3. */
#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if FMI == 2
#include "fmi2Functions.h"
typedef fmi2Component unit;
#else
#include "fmi3Functions.h"
typedef fmi3Instance unit;
#endif

#define UNITS 3
#define STATES 4
#define BATCH 8
#define BLOB (1 << 16)

static uint64_t seed;
static const char *token;
static double step_size;
static unsigned nvariable;
static unit units[UNITS];
static double clocks[UNITS]; /* where the last step of a unit ended */
static int running[UNITS];   /* whether it may take one */
static void *states[STATES];
static double state_clocks[STATES];
static int state_running[STATES];
static unsigned char blob[BLOB];
static size_t blob_size;
static long calls[32], refused[32], messages;
static int failure, usual;
static unsigned lively;

static uint64_t draw(void) { /* xorshift64* */
    seed ^= seed >> 12;
    seed ^= seed << 25;
    seed ^= seed >> 27;
    return seed * 2685821657736338717ULL;
}

static unsigned below(unsigned n) {
    return (unsigned)(draw() >> 33) % n;
}

/* Mostly a value of a usual size, else one of any size, or none. */
static double number(void) {
    const double odd[] = {0.0,      -0.0,    NAN,    INFINITY, -INFINITY, DBL_MAX,
                          -DBL_MAX, DBL_MIN, 5e-324, 1e150,    -1e200,    1e-200};
    double u = (double)(draw() >> 11) / 9007199254740992.0 * 2.0 - 1.0;
    switch (usual ? 7 : below(8)) {
    case 0:
        return odd[below(sizeof(odd) / sizeof(odd[0]))];
    case 1:
        return u * pow(10.0, (double)below(600) - 300.0);
    default:
        return u * pow(10.0, (double)below(5) - 2.0);
    }
}

static unsigned reference(void) {
    return below(16) ? below(nvariable) : (unsigned)draw();
}

static const char *text(void) {
    const char *known[] = {"logStatusError", "logNonlinearSystems", "", "%s%n", NULL, "unit"};
    return known[below(6)];
}

#if FMI == 2
static void logger(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...) {
    (void)e, (void)status;
    messages += (long)(strlen(name) + strlen(category) + strlen(message) > 0);
}
static const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
#else
static void logger(fmi3InstanceEnvironment e, fmi3Status status, fmi3String category, fmi3String message) {
    (void)e, (void)status;
    messages += (long)(strlen(category) + strlen(message) > 0);
}
#endif

/* The names both versions share. */
#if FMI == 2
#define OF(name2, name3) fmi2##name2
#define N(n)
#else
#define OF(name2, name3) fmi3##name3
#define N(n) , (n)
#endif

static unit instantiate(void) {
    const char *with = usual || below(8) ? token : text();
    const char *name = usual || below(8) ? "unit" : text();
#if FMI == 2
    return fmi2Instantiate(name, below(16) ? fmi2CoSimulation : fmi2ModelExchange, with, text(),
                           below(16) ? &callbacks : NULL, 0, (int)below(2));
#else
    return fmi3InstantiateCoSimulation(name, with, text(), false, below(2), !below(16), below(2), NULL,
                                       below(16) ? 0 : 3, NULL, below(16) ? logger : NULL, NULL);
#endif
}

static int set_up(unit c, unsigned i) {
    double start = usual || below(4) ? 0.0 : number();
    clocks[i] = start; /* where the last step of a unit that is started ends */
#if FMI == 2
    return !usual && below(2) ? (int)fmi2SetupExperiment(c, 0, 0.0, start, !below(4), number())
                              : (int)fmi2EnterInitializationMode(c);
#else
    return (int)fmi3EnterInitializationMode(c, false, 0.0, start, !usual && below(4) == 0, number());
#endif
}

static int get(unit c) {
    unsigned ref[BATCH], n = below(BATCH + 1);
    double value[BATCH];
    int status;
    for (unsigned i = 0; i < n; i++)
        ref[i] = reference();
    status = (int)OF(GetReal, GetFloat64)(c, below(64) ? ref : NULL, n,
                                          below(64) ? value : NULL N(below(32) ? n : below(BATCH)));
    for (unsigned i = 0; i < n && status == 0; i++)
        if (!isfinite(value[i])) {
            fprintf(stderr, "variable %u is %g\n", ref[i], value[i]);
            failure = 1;
        }
    return status;
}

static int set(unit c) {
    unsigned ref[BATCH], n = usual ? 1 : below(BATCH + 1);
    double value[BATCH];
    for (unsigned i = 0; i < n; i++) {
        ref[i] = reference();
        value[i] = number();
    }
    return (int)OF(SetReal, SetFloat64)(c, below(64) ? ref : NULL, n,
                                        below(64) ? value : NULL N(below(32) ? n : below(BATCH)));
}

/* Up to forty internal steps: what a caller asks for beyond that is its own time. */
static int do_step(unit c, unsigned i) {
    double t = usual || below(4) ? clocks[i] : number(),
           h = usual || below(4) ? step_size * (double)(1 + below(40)) / 8.0 : number();
    double last;
    int status;
    if (h > 5.0 * step_size && h < 1e9 * step_size)
        h = 5.0 * step_size;
    last = t + h; /* unless it returns early */
#if FMI == 2
    status = (int)fmi2DoStep(c, t, h, 1);
#else
    bool flag[3];
    if (below(16))
        status = (int)fmi3DoStep(c, t, h, true, &flag[0], &flag[1], &flag[2], &last);
    else
        status = (int)fmi3DoStep(c, t, h, true, NULL, NULL, NULL, NULL);
#endif
    if (status == 0) {
        clocks[i] = last;
        if (!(h > 0.0) || !isfinite(t + h))
            failure = 2;
    }
    return status;
}

static int derivative(unit c) {
    unsigned unknown[BATCH], known[BATCH], n = below(4), m = below(4);
    double seeds[BATCH], result[BATCH];
    int status;
    for (unsigned i = 0; i < BATCH; i++) {
        unknown[i] = reference();
        known[i] = reference();
        seeds[i] = number();
    }
#if FMI == 2
    status = (int)fmi2GetDirectionalDerivative(c, unknown, n, known, m, seeds, result);
#else
    if (below(2)) {
        status = (int)fmi3GetAdjointDerivative(c, unknown, n, known, m, seeds, n, result, m);
        n = m;
    } else {
        status = (int)fmi3GetDirectionalDerivative(c, unknown, n, known, m, seeds, m, result, n);
    }
#endif
    for (unsigned i = 0; i < n && status == 0; i++)
        if (!isfinite(result[i]))
            failure = 1;
    return status;
}

static int serialize(unit c, void *state) {
    size_t size = 0;
    if (OF(SerializedFMUstateSize, SerializedFMUStateSize)(c, state, &size) || size > BLOB)
        return 3;
    blob_size = below(8) ? size : below((unsigned)size + 1);
    return (int)OF(SerializeFMUstate, SerializeFMUState)(c, state, below(64) ? blob : NULL, blob_size);
}

/* From the bytes of the last serialization, often damaged. */
static int deserialize(unit c, void **state) {
    int damaged = !usual && below(2) && blob_size > 0, status;
    if (damaged)
        blob[below((unsigned)blob_size)] ^= (unsigned char)(1 + below(255));
    status = (int)OF(DeSerializeFMUstate, DeserializeFMUState)(
        c, blob, below(8) ? blob_size : below((unsigned)blob_size + 1), state);
    if (damaged && status == 0)
        failure = 2;
    if (damaged)
        blob_size = 0;
    return status;
}

static int logging(unit c) {
    const char *names[3] = {text(), text(), text()};
    return (int)OF(SetDebugLogging, SetDebugLogging)(c, below(2), below(4), below(8) ? names : NULL);
}

static int others(unit c) {
#if FMI == 2
    fmi2Real value = 0.0;
    fmi2Boolean flag;
    switch (below(3)) {
    case 0:
        return (int)fmi2GetRealStatus(c, (fmi2StatusKind)below(8), &value);
    case 1:
        return (int)fmi2GetBooleanStatus(c, (fmi2StatusKind)below(8), &flag);
    default:
        return (int)fmi2CancelStep(c);
    }
#else
    switch (below(3)) {
    case 0:
        return (int)fmi3EnterEventMode(c);
    case 1:
        return (int)fmi3EnterStepMode(c);
    default:
        return (int)fmi3EvaluateDiscreteStates(c);
    }
#endif
}

static int call(unsigned what, unsigned i) {
    unit c = below(64) ? units[i] : NULL;
    void **state = &states[below(STATES)];
    int status = 0;
    switch (what) {
    case 0:
        if (!units[i])
            units[i] = instantiate();
        return units[i] ? 0 : 3;
    case 1:
        if (below(4)) /* seldom: what happens in a long life */
            return 0;
        OF(FreeInstance, FreeInstance)(c);
        if (c) {
            units[i] = NULL;
            running[i] = 0;
        }
        return 0;
    case 2:
        return set_up(c, i);
    case 3:
#if FMI == 2
        return (int)fmi2EnterInitializationMode(c);
#endif
    case 4:
        status = (int)OF(ExitInitializationMode, ExitInitializationMode)(c);
        running[i] = running[i] || status == 0;
        return status;
    case 5:
        if (below(16))
            return 0;
        running[i] = 0;
        return (int)OF(Terminate, Terminate)(c);
    case 6:
        if (below(4))
            return 0;
        clocks[i] = running[i] = 0;
        return (int)OF(Reset, Reset)(c);
    case 7:
    case 8:
        return get(c);
    case 9:
    case 10:
        return set(c);
    case 11:
    case 12:
    case 13:
        return do_step(c, i);
    case 14:
        return derivative(c);
    case 15:
        status = (int)OF(GetFMUstate, GetFMUState)(c, below(64) ? state : NULL);
        if (status == 0) {
            state_clocks[state - states] = clocks[i];
            state_running[state - states] = running[i];
        }
        return status;
    case 16:
        status = (int)OF(SetFMUstate, SetFMUState)(c, *state);
        if (status == 0) {
            clocks[i] = state_clocks[state - states];
            running[i] = state_running[state - states];
        }
        break;
    case 17:
        return below(4) ? 0 : (int)OF(FreeFMUstate, FreeFMUState)(c, state);
    case 18:
        return serialize(c, *state);
    case 19:
        return deserialize(c, state);
    case 20:
        return logging(c);
    default:
        return others(c);
    }
    return status;
}

#define KINDS 22

/* A unit that is not stepping is started as importers do. */
static void begin(unsigned i) {
    if (!units[i])
        units[i] = instantiate();
    if (!units[i])
        return;
    OF(Reset, Reset)(units[i]);
    (void)set_up(units[i], i);
    (void)call(4, i);
}

int main(int argc, char **argv) {
    long total = 0;
    if (argc != 7)
        return 3;
    token = argv[1];
    seed = strtoull(argv[3], NULL, 10) * 2654435761ULL + 1;
    step_size = atof(argv[4]);
    nvariable = (unsigned)atoi(argv[5]);
    lively = (unsigned)atoi(argv[6]);
    for (long k = 0, n = atol(argv[2]); k < n && !failure; k++, total++) {
        static const unsigned simulation[] = {7, 9, 11, 11, 11, 11, 15, 16};
        unsigned what;
        usual = below(lively + 1) > 0;
        what = usual ? simulation[below(sizeof(simulation) / sizeof(simulation[0]))] : below(KINDS);
        unsigned i = below(UNITS);
        if (usual && !running[i])
            begin(i);
        calls[what]++;
        refused[what] += call(what, i) != 0;
    }
    for (int i = 0; i < UNITS; i++)
        if (units[i])
            for (int s = 0; s < STATES; s++)
                OF(FreeFMUstate, FreeFMUState)(units[i], &states[s]);
    for (int i = 0; i < UNITS; i++)
        OF(FreeInstance, FreeInstance)(units[i]);
    printf("calls %ld messages %ld\n", total, messages);
    for (int i = 0; i < KINDS; i++)
        printf("%d %ld %ld\n", i, calls[i], refused[i]);
    return failure;
}
