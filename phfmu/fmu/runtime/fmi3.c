/* FMI 3.0 for Co-Simulation: the functions this unit has. The others are in fmi3_absent.c. */
#include "fmi3Functions.h"

#include "fmu.h"

static int check_count(const fmu *f, const char *function, size_t expected, size_t given) {
    if (expected == given)
        return FMU_OK;
    return fmu_refuse(f, "%s: %zu values for %zu scalar variables", function, given, expected);
}

/* Number of scalars of a variable; references that are not there are refused where they are used. */
static size_t size_of(const fmu *f, unsigned ref) {
    return ref < (unsigned)f->about->nvariable ? (size_t)f->about->sizes[ref] : 1;
}

/* *scalars: nvalues references of the scalars of the n variables `ref`, in `ref` itself without arrays, else
 * in the `half` (0, 1) of the instance's own room, until the next call with it. FMU_ERROR if their number is
 * another one. */
static int scalars_of(fmu *f, const char *function, int half, const unsigned *ref, size_t n, size_t nvalues,
                      const unsigned **scalars) {
    size_t total = 0, room;
    unsigned *place;
    *scalars = ref;
    if (!f || !f->about->sizes)
        return check_count(f, function, n, nvalues);
    for (size_t i = 0; i < n; i++)
        total += size_of(f, ref[i]);
    if (check_count(f, function, total, nvalues))
        return FMU_ERROR;
    room = (size_t)f->about->nvariable;
    if (total > room)
        return fmu_refuse(f, "%s: %zu values in one call, the unit has %zu variables; name none twice",
                          function, total, room);
    place = f->scalars + (half ? room : 0);
    *scalars = place;
    for (size_t i = 0; i < n; i++)
        for (unsigned k = 0; k < (unsigned)size_of(f, ref[i]); k++)
            *place++ = ref[i] + k;
    return FMU_OK;
}

#define STATUS(call) ((fmi3Status)(call))

const char *fmi3GetVersion(void) {
    return fmi3Version;
}

static void sink(const fmu *f, int status, const char *category, const char *text) {
    ((fmi3LogMessageCallback)f->callback)(f->environment, STATUS(status), category, text);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken,
                                         fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                         fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables,
                                         fmi3InstanceEnvironment instanceEnvironment,
                                         fmi3LogMessageCallback logMessage,
                                         fmi3IntermediateUpdateCallback intermediateUpdate) {
    fmu *f;
    (void)visible;
    (void)requiredIntermediateVariables;
    (void)intermediateUpdate;
    f = fmu_create(instanceName, instantiationToken, resourcePath, loggingOn ? FMU_LOG_ALL : 0, sink,
                   (void (*)(void))logMessage, instanceEnvironment);
    if (f)
        f->early = earlyReturnAllowed;
    if (!f || (!eventModeUsed && nRequiredIntermediateVariables == 0))
        return f;
    fmu_refuse(f, "%s: there is no event mode and no intermediate update", __func__);
    fmu_free(f);
    return NULL;
}

void fmi3FreeInstance(fmi3Instance instance) {
    fmu_free(instance);
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[]) {
    return STATUS(fmu_log(instance, __func__, loggingOn, nCategories, categories));
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined,
                                       fmi3Float64 tolerance, fmi3Float64 startTime,
                                       fmi3Boolean stopTimeDefined, fmi3Float64 stopTime) {
    (void)toleranceDefined; /* equations are solved to rounding */
    (void)tolerance;
    if (fmu_setup(instance, __func__, startTime, stopTimeDefined, stopTime))
        return fmi3Error;
    return STATUS(fmu_enter(instance, __func__));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    return STATUS(fmu_leave(instance, __func__));
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
    return STATUS(fmu_terminate(instance, __func__));
}

fmi3Status fmi3Reset(fmi3Instance instance) {
    return STATUS(fmu_reset(instance, __func__));
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, fmi3Float64 values[], size_t nValues) {
    const unsigned *scalars;
    if (scalars_of(instance, __func__, 0, valueReferences, nValueReferences, nValues, &scalars))
        return fmi3Error;
    return STATUS(fmu_get(instance, __func__, scalars, nValues, values));
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, const fmi3Float64 values[], size_t nValues) {
    const unsigned *scalars;
    if (scalars_of(instance, __func__, 0, valueReferences, nValueReferences, nValues, &scalars))
        return fmi3Error;
    return STATUS(fmu_set(instance, __func__, scalars, nValues, values));
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState) {
    return STATUS(fmu_save(instance, __func__, FMUState));
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState) {
    return STATUS(fmu_restore(instance, __func__, FMUState));
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState) {
    return STATUS(fmu_forget(instance, FMUState));
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size) {
    return STATUS(fmu_written_size(instance, __func__, FMUState, size));
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState, fmi3Byte serializedState[],
                                 size_t size) {
    return STATUS(fmu_write(instance, __func__, FMUState, serializedState, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[], size_t size,
                                   fmi3FMUState *FMUState) {
    return STATUS(fmu_read(instance, __func__, serializedState, size, FMUState));
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                        size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns,
                                        const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[],
                                        size_t nSensitivity) {
    const unsigned *from, *to;
    if (scalars_of(instance, __func__, 0, knowns, nKnowns, nSeed, &from) ||
        scalars_of(instance, __func__, 1, unknowns, nUnknowns, nSensitivity, &to))
        return fmi3Error;
    return STATUS(fmu_derivative(instance, __func__, 0, to, nSensitivity, from, nSeed, seed, sensitivity));
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                    size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns,
                                    const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[],
                                    size_t nSensitivity) {
    const unsigned *from, *to;
    if (scalars_of(instance, __func__, 0, unknowns, nUnknowns, nSeed, &to) ||
        scalars_of(instance, __func__, 1, knowns, nKnowns, nSensitivity, &from))
        return fmi3Error;
    return STATUS(fmu_derivative(instance, __func__, 1, to, nSeed, from, nSensitivity, seed, sensitivity));
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint,
                      fmi3Float64 communicationStepSize, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime) {
    int early = 0;
    int status = fmu_do_step(instance, __func__, currentCommunicationPoint, communicationStepSize,
                             earlyReturn && lastSuccessfulTime ? &early : NULL);
    (void)noSetFMUStatePriorToCurrentPoint;
    if (eventHandlingNeeded)
        *eventHandlingNeeded = fmi3False;
    if (terminateSimulation)
        *terminateSimulation = fmi3False;
    if (earlyReturn)
        *earlyReturn = early != 0;
    if (instance && lastSuccessfulTime)
        *lastSuccessfulTime = fmu_time(instance);
    return STATUS(status);
}
