/* A host without an interpreter: loads the library of a unit, runs it through FMI 2.0 or 3.0 and prints
 * values.
 *
 *     fmu_host LIBRARY VERSION TOKEN STEP N INPUT_REFERENCE VALUE OUTPUT_REFERENCE...
 *
 * INPUT_REFERENCE -1: no input. */
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"
#include "fmi3FunctionTypes.h"

static void logger2(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category,
                    fmi2String message, ...) {
    (void)e;
    fprintf(stderr, "%s %d %s: %s\n", name, (int)status, category, message);
}

static void logger3(fmi3InstanceEnvironment e, fmi3Status status, fmi3String category, fmi3String message) {
    (void)e;
    fprintf(stderr, "%d %s: %s\n", (int)status, category, message);
}

static void *symbol(void *library, const char *name) {
    void *found = dlsym(library, name);
    if (!found) {
        fprintf(stderr, "no function %s\n", name);
        exit(1);
    }
    return found;
}

/* ISO C has no conversion from an object pointer to a function pointer; dlsym needs one. */
#define FUNCTION(type, variable, name)                                                                       \
    type *variable;                                                                                          \
    *(void **)(&variable) = symbol(library, name)

#define MUST(call)                                                                                           \
    do {                                                                                                     \
        if ((call) != 0) {                                                                                   \
            fprintf(stderr, "failed: %s\n", #call);                                                          \
            return 1;                                                                                        \
        }                                                                                                    \
    } while (0)

static int run2(void *library, const char *token, double h, int n, int input, double u, const unsigned *ref,
                int m) {
    const fmi2CallbackFunctions callbacks = {logger2, calloc, free, NULL, NULL};
    FUNCTION(fmi2InstantiateTYPE, instantiate, "fmi2Instantiate");
    FUNCTION(fmi2SetupExperimentTYPE, setup, "fmi2SetupExperiment");
    FUNCTION(fmi2EnterInitializationModeTYPE, enter, "fmi2EnterInitializationMode");
    FUNCTION(fmi2ExitInitializationModeTYPE, leave, "fmi2ExitInitializationMode");
    FUNCTION(fmi2SetRealTYPE, set, "fmi2SetReal");
    FUNCTION(fmi2GetRealTYPE, get, "fmi2GetReal");
    FUNCTION(fmi2DoStepTYPE, step, "fmi2DoStep");
    FUNCTION(fmi2TerminateTYPE, terminate, "fmi2Terminate");
    FUNCTION(fmi2FreeInstanceTYPE, release, "fmi2FreeInstance");
    fmi2Component c = instantiate("host", fmi2CoSimulation, token, "file:///", &callbacks, 0, 0);
    unsigned in = (unsigned)input;
    if (!c)
        return 1;
    MUST(setup(c, 0, 0.0, 0.0, 0, 0.0));
    MUST(enter(c));
    if (input >= 0)
        MUST(set(c, &in, 1, &u));
    MUST(leave(c));
    for (int k = 0; k < n; k++)
        MUST(step(c, k * h, h, 1));
    for (int i = 0; i < m; i++) {
        double value;
        MUST(get(c, &ref[i], 1, &value));
        printf("%.17g\n", value);
    }
    MUST(terminate(c));
    release(c);
    return 0;
}

static int run3(void *library, const char *token, double h, int n, int input, double u, const unsigned *ref,
                int m) {
    FUNCTION(fmi3InstantiateCoSimulationTYPE, instantiate, "fmi3InstantiateCoSimulation");
    FUNCTION(fmi3EnterInitializationModeTYPE, enter, "fmi3EnterInitializationMode");
    FUNCTION(fmi3ExitInitializationModeTYPE, leave, "fmi3ExitInitializationMode");
    FUNCTION(fmi3SetFloat64TYPE, set, "fmi3SetFloat64");
    FUNCTION(fmi3GetFloat64TYPE, get, "fmi3GetFloat64");
    FUNCTION(fmi3DoStepTYPE, step, "fmi3DoStep");
    FUNCTION(fmi3TerminateTYPE, terminate, "fmi3Terminate");
    FUNCTION(fmi3FreeInstanceTYPE, release, "fmi3FreeInstance");
    fmi3Instance c = instantiate("host", token, NULL, 0, 0, 0, 0, NULL, 0, NULL, logger3, NULL);
    unsigned in = (unsigned)input;
    if (!c)
        return 1;
    MUST(enter(c, 0, 0.0, 0.0, 0, 0.0));
    if (input >= 0)
        MUST(set(c, &in, 1, &u, 1));
    MUST(leave(c));
    for (int k = 0; k < n; k++) {
        bool event, end, early;
        double last;
        MUST(step(c, k * h, h, 1, &event, &end, &early, &last));
    }
    for (int i = 0; i < m; i++) {
        double value;
        MUST(get(c, &ref[i], 1, &value, 1));
        printf("%.17g\n", value);
    }
    MUST(terminate(c));
    release(c);
    return 0;
}

int main(int argc, char **argv) {
    unsigned ref[64];
    void *library;
    int m = argc - 8;
    if (m < 1 || m > 64)
        return 2;
    library = dlopen(argv[1], RTLD_NOW | RTLD_LOCAL);
    if (!library) {
        fprintf(stderr, "%s\n", dlerror());
        return 1;
    }
    for (int i = 0; i < m; i++)
        ref[i] = (unsigned)atoi(argv[8 + i]);
    return (strcmp(argv[2], "2.0") == 0 ? run2 : run3)(library, argv[3], atof(argv[4]), atoi(argv[5]),
                                                       atoi(argv[6]), atof(argv[7]), ref, m);
}
