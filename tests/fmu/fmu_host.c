/* A host without an interpreter: loads the library of a unit, runs it through FMI 2.0 or 3.0 and prints
 * values.
 *
 *     fmu_host LIBRARY VERSION TOKEN STEP N INPUT_REFERENCE VALUE MORE OUTPUT_REFERENCE...
 *
 * INPUT_REFERENCE -1: no input. MORE: lengths of steps that follow the N, joined by commas, or -; after each
 * of them values are printed again. VERSION 3.0-early: the unit may return early. Where it does, or discards
 * a step, the last successful time and the values there are printed, and the run ends; VERSION 3.0-events: it
 * goes on from there to the end of the step. VERSION 2.0-sums, 3.0-sums: the clock of the host is t += STEP.
 */
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

typedef struct plan {
    double h, u, more[64], t;
    int n, nmore, input, m, early, on, sums;
    unsigned ref[1024];
} plan;

static int run2(void *library, const char *token, plan *p) {
    const fmi2CallbackFunctions callbacks = {logger2, calloc, free, NULL, NULL};
    FUNCTION(fmi2InstantiateTYPE, instantiate, "fmi2Instantiate");
    FUNCTION(fmi2SetupExperimentTYPE, setup, "fmi2SetupExperiment");
    FUNCTION(fmi2EnterInitializationModeTYPE, enter, "fmi2EnterInitializationMode");
    FUNCTION(fmi2ExitInitializationModeTYPE, leave, "fmi2ExitInitializationMode");
    FUNCTION(fmi2SetRealTYPE, set, "fmi2SetReal");
    FUNCTION(fmi2GetRealTYPE, get, "fmi2GetReal");
    FUNCTION(fmi2DoStepTYPE, step, "fmi2DoStep");
    FUNCTION(fmi2GetRealStatusTYPE, inquire, "fmi2GetRealStatus");
    FUNCTION(fmi2TerminateTYPE, terminate, "fmi2Terminate");
    FUNCTION(fmi2FreeInstanceTYPE, release, "fmi2FreeInstance");
    fmi2Component c = instantiate("host", fmi2CoSimulation, token, "file:///", &callbacks, 0, 0);
    unsigned in = (unsigned)p->input;
    if (!c)
        return 1;
    MUST(setup(c, 0, 0.0, 0.0, 0, 0.0));
    MUST(enter(c));
    if (p->input >= 0)
        MUST(set(c, &in, 1, &p->u));
    MUST(leave(c));
    for (int k = 0; k < p->n + p->nmore; k++) {
        const double h = k < p->n ? p->h : p->more[k - p->n];
        double last;
        int status = step(c, p->t, h, 0);
        if (status == fmi2Discard) {
            MUST(inquire(c, fmi2LastSuccessfulTime, &last));
            printf("%.17g\n", last);
            p->n = k + 1;
            p->nmore = 0;
            status = 0;
        }
        MUST(status);
        p->t = k < p->n && !p->sums ? (k + 1) * h : p->t + h;
        for (int i = 0; k + 1 >= p->n && i < p->m; i++) {
            double value;
            MUST(get(c, &p->ref[i], 1, &value));
            printf("%.17g\n", value);
        }
    }
    MUST(terminate(c));
    release(c);
    return 0;
}

static int run3(void *library, const char *token, plan *p) {
    FUNCTION(fmi3InstantiateCoSimulationTYPE, instantiate, "fmi3InstantiateCoSimulation");
    FUNCTION(fmi3EnterInitializationModeTYPE, enter, "fmi3EnterInitializationMode");
    FUNCTION(fmi3ExitInitializationModeTYPE, leave, "fmi3ExitInitializationMode");
    FUNCTION(fmi3SetFloat64TYPE, set, "fmi3SetFloat64");
    FUNCTION(fmi3GetFloat64TYPE, get, "fmi3GetFloat64");
    FUNCTION(fmi3DoStepTYPE, step, "fmi3DoStep");
    FUNCTION(fmi3TerminateTYPE, terminate, "fmi3Terminate");
    FUNCTION(fmi3FreeInstanceTYPE, release, "fmi3FreeInstance");
    fmi3Instance c = instantiate("host", token, NULL, 0, 1, 0, p->early, NULL, 0, NULL, logger3, NULL);
    unsigned in = (unsigned)p->input;
    if (!c)
        return 1;
    MUST(enter(c, 0, 0.0, 0.0, 0, 0.0));
    if (p->input >= 0)
        MUST(set(c, &in, 1, &p->u, 1));
    MUST(leave(c));
    for (int k = 0; k < p->n + p->nmore; k++) {
        const double h = k < p->n ? p->h : p->more[k - p->n],
                     end = k < p->n && !p->sums ? (k + 1) * h : p->t + h;
        bool event, stop, early = false;
        double last, t = p->t, part = h;
        do {
            MUST(step(c, t, part, 0, &event, &stop, &early, &last));
            if (event || stop)
                return 1;
            if (early)
                printf("%.17g\n", last);
            if (early && !p->on) {
                p->n = k + 1;
                p->nmore = 0;
            }
            for (int i = 0; ((early && p->on) || k + 1 >= p->n) && i < p->m; i++) {
                double value;
                MUST(get(c, &p->ref[i], 1, &value, 1));
                printf("%.17g\n", value);
            }
            t = last;
            part = end - last;
        } while (early && p->on);
        p->t = end;
    }
    MUST(terminate(c));
    release(c);
    return 0;
}

int main(int argc, char **argv) {
    static plan p;
    char *more;
    void *library;
    p.m = argc - 9;
    if (p.m < 1 || p.m > 1024)
        return 2;
    library = dlopen(argv[1], RTLD_NOW | RTLD_LOCAL);
    if (!library) {
        fprintf(stderr, "%s\n", dlerror());
        return 1;
    }
    p.on = strcmp(argv[2], "3.0-events") == 0;
    p.sums = strcmp(argv[2], "2.0-sums") == 0 || strcmp(argv[2], "3.0-sums") == 0;
    p.early = p.on || strcmp(argv[2], "3.0-early") == 0;
    p.h = atof(argv[4]);
    p.n = atoi(argv[5]);
    p.input = atoi(argv[6]);
    p.u = atof(argv[7]);
    for (more = strtok(argv[8], ","); more && strcmp(more, "-") != 0 && p.nmore < 64;
         more = strtok(NULL, ","))
        p.more[p.nmore++] = atof(more);
    for (int i = 0; i < p.m; i++)
        p.ref[i] = (unsigned)atoi(argv[9 + i]);
    return (argv[2][0] == '2' ? run2 : run3)(library, argv[3], &p);
}
