/* A host that writes states of its own: bits and words of serialized ones are changed and the checksum is
 * made to fit again, on a unit of one version compiled into it together with sanitizers.
 *
 *     forged_states TOKEN TRIALS SEED STEP NVARIABLE TIME [INPUT OUTPUT]
 *
 * The last three are value references: of the time (FMI 3), and of an input and an output that has a
 * derivative by it. A forged state is refused, and then neither the unit nor the state it was to replace has
 * changed; or it is taken, read and stepped on from. From time to time an honest state has to go on with the
 * same bits as before. Prints trials, refused, taken, steps refused after that. Exit code 1: something
 * changed that must not; 2: a value was read that is not finite, although the call said OK; 3: the unit
 * refused honest calls. -DFMI=2 or 3. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#if FMI == 2
#include "fmi2Functions.h"
typedef fmi2Component unit;
#define OF(name2, name3) fmi2##name2
#define N(n)
#else
#include "fmi3Functions.h"
typedef fmi3Instance unit;
#define OF(name2, name3) fmi3##name3
#define N(n) , (n)
#endif

#define BLOB (1 << 18)
#define SUM 48      /* where the checksum of a serialized state is */
#define HEAD 512    /* bytes with the counters and switches, which half of the changes aim at */
#define PATIENCE 20 /* s that one trial may take */

static uint64_t seed;
static double step_size;
static unsigned nvariable, time_reference, input_reference, output_reference;
static int has_derivative;
static long refused, taken, steps_refused;
static unsigned char honest[BLOB], forged[BLOB], before[BLOB], after[BLOB], expected[BLOB];
static size_t size;

static uint64_t draw(void) { /* xorshift64* */
    seed ^= seed >> 12;
    seed ^= seed << 25;
    seed ^= seed >> 27;
    return seed * 2685821657736338717ULL;
}

static size_t below(size_t n) {
    return (size_t)(draw() >> 11) % n;
}

static void fail(int code, const char *what) {
    fprintf(stderr, "%s\n", what);
    exit(code);
}

#if FMI == 2
static void logger(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...) {
    (void)e, (void)name, (void)status, (void)category, (void)message;
}
static const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
#else
static void logger(fmi3InstanceEnvironment e, fmi3Status status, fmi3String category, fmi3String message) {
    (void)e, (void)status, (void)category, (void)message;
}
#endif

static unit begin(const char *token) {
#if FMI == 2
    unit c = fmi2Instantiate("unit", fmi2CoSimulation, token, "", &callbacks, 0, 0);
    if (!c || fmi2SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0) || fmi2EnterInitializationMode(c) ||
        fmi2ExitInitializationMode(c))
        fail(3, "the unit does not begin");
#else
    unit c = fmi3InstantiateCoSimulation("unit", token, "", false, false, false, true, NULL, 0, NULL, logger,
                                         NULL);
    if (!c || fmi3EnterInitializationMode(c, false, 0.0, 0.0, false, 0.0) || fmi3ExitInitializationMode(c))
        fail(3, "the unit does not begin");
#endif
    return c;
}

static int get(unit c, unsigned ref, double *value) {
    return (int)OF(GetReal, GetFloat64)(c, &ref, 1, value N(1));
}

static int do_step(unit c, double parts) {
    double t = 0.0;
#if FMI == 2
    if (fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &t))
        return 3;
    return (int)fmi2DoStep(c, t, parts * step_size, 1);
#else
    bool flag[3];
    double last;
    if (get(c, time_reference, &t))
        return 3;
    return (int)fmi3DoStep(c, t, parts * step_size, true, &flag[0], &flag[1], &flag[2], &last);
#endif
}

static void read_all(unit c) {
    for (unsigned i = 0; i < nvariable; i++) {
        double value = 0.0;
        if (get(c, i, &value) == 0 && !isfinite(value))
            fail(2, "a value is not finite");
    }
    if (has_derivative) {
        double one = 1.0, result = 0.0;
#if FMI == 2
        fmi2GetDirectionalDerivative(c, &output_reference, 1, &input_reference, 1, &one, &result);
#else
        fmi3GetDirectionalDerivative(c, &output_reference, 1, &input_reference, 1, &one, 1, &result, 1);
#endif
    }
}

static void serialize(unit c, unsigned char *bytes) {
    void *state = NULL;
    if (OF(GetFMUstate, GetFMUState)(c, &state) ||
        OF(SerializedFMUstateSize, SerializedFMUStateSize)(c, state, &size) || size > BLOB ||
        OF(SerializeFMUstate, SerializeFMUState)(c, state, bytes, size) ||
        OF(FreeFMUstate, FreeFMUState)(c, &state))
        fail(3, "the unit does not save its state");
}

static int deserialize(unit c, const unsigned char *bytes, void **state) {
    return (int)OF(DeSerializeFMUstate, DeserializeFMUState)(c, bytes, size, state);
}

static void restore(unit c, const unsigned char *bytes) {
    void *state = NULL;
    if (deserialize(c, bytes, &state) || OF(SetFMUstate, SetFMUState)(c, state))
        fail(3, "the unit refuses a state of its own");
    OF(FreeFMUstate, FreeFMUState)(c, &state);
}

/* FNV-1a with its own place as zero. */
static void fit_sum(unsigned char *bytes) {
    uint64_t hash = 14695981039346656037ULL;
    memset(bytes + SUM, 0, sizeof(hash));
    for (size_t i = 0; i < size; i++)
        hash = (hash ^ bytes[i]) * 1099511628211ULL;
    memcpy(bytes + SUM, &hash, sizeof(hash));
}

static void change(unsigned char *bytes) {
    const int32_t odd[] = {-1, -2, 1, 2, 3, 7, 17, 64, 255, 1000, 65536, 1 << 30, INT32_MAX, INT32_MIN};
    const double numbers[] = {NAN, INFINITY, -INFINITY, 1e308, -1e308, 1e-320, 0.0, -0.0, 1.0, -1.0, 1e9};
    const size_t reach = below(2) && size > HEAD ? HEAD : size;
    switch (below(4)) {
    case 0:
        bytes[below(reach)] ^= (unsigned char)(1u << below(8));
        break;
    case 1:
        bytes[below(reach)] = (unsigned char)draw();
        break;
    case 2:
        memcpy(bytes + below(reach / 4) * 4, &odd[below(sizeof(odd) / sizeof(*odd))], 4);
        break;
    default:
        memcpy(bytes + below(reach / 8) * 8, &numbers[below(sizeof(numbers) / sizeof(*numbers))], 8);
    }
}

static void trial(unit c) {
    void *state = NULL;
    memcpy(forged, honest, size);
    for (size_t n = below(4) ? 1 : 1 + below(8); n > 0; n--)
        change(forged);
    fit_sum(forged);
    serialize(c, before);
    if (deserialize(c, forged, &state)) {
        refused++;
        serialize(c, after);
        if (state || memcmp(before, after, size) != 0)
            fail(1, "a refused state has changed something");
        return;
    }
    taken++;
    if (OF(SetFMUstate, SetFMUState)(c, state))
        fail(1, "a state was taken and is not restored");
    OF(FreeFMUstate, FreeFMUState)(c, &state);
    read_all(c);
    for (int i = 0; i < 3; i++)
        steps_refused += do_step(c, i == 1 ? 2.5 : 1.0) != 0;
    read_all(c);
}

int main(int argc, char **argv) {
    unit c;
    const long trials = argc > 2 ? atol(argv[2]) : 0;
    if (argc != 7 && argc != 9)
        return 3;
    seed = strtoull(argv[3], NULL, 10) * 2654435761ULL + 1;
    step_size = atof(argv[4]);
    nvariable = (unsigned)atoi(argv[5]);
    time_reference = (unsigned)atoi(argv[6]);
    has_derivative = argc == 9;
    input_reference = has_derivative ? (unsigned)atoi(argv[7]) : 0;
    output_reference = has_derivative ? (unsigned)atoi(argv[8]) : 0;
    c = begin(argv[1]);
    for (long k = 0; k < trials; k++) {
        if (k % 50 == 0) { /* another honest state, further on; a scene that cannot go on begins again */
            alarm(PATIENCE);
            if (k)
                restore(c, honest);
            if (do_step(c, k % 100 ? 1.0 : 7.5) != 0) {
                OF(FreeInstance, FreeInstance)(c);
                c = begin(argv[1]);
            }
            read_all(c);
            serialize(c, honest);
            do_step(c, 2.0);
            serialize(c, expected);
        }
        alarm(PATIENCE);
        trial(c);
        if (k % 50 == 49) {
            restore(c, honest);
            do_step(c, 2.0);
            serialize(c, after);
            if (memcmp(after, expected, size) != 0)
                fail(1, "an honest state goes on with other bits");
        }
    }
    OF(FreeInstance, FreeInstance)(c);
    printf("%ld %ld %ld %ld\n", trials, refused, taken, steps_refused);
    return 0;
}
