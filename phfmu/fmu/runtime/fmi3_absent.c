/* FMI 3.0: functions that have to exist for what this unit has not. */
#include "fmi3Functions.h"

#include "fmu.h"

#define ABSENT(instance, what) ((fmi3Status)fmu_refuse(instance, "%s: this unit has no %s", __func__, what))

/* Importers may ask for no values of a type. */
static fmi3Status none(fmi3Instance instance, const char *function, size_t n) {
    if (n == 0 && instance)
        return fmi3OK;
    return (fmi3Status)fmu_refuse(instance, "%s: all variables are of the type Float64", function);
}

#define OTHER_TYPE(Name, Type)                                                                               \
    fmi3Status fmi3Get##Name(fmi3Instance instance, const fmi3ValueReference ref[], size_t n, Type values[], \
                             size_t m) {                                                                     \
        (void)ref;                                                                                           \
        (void)values;                                                                                        \
        (void)m;                                                                                             \
        return none(instance, __func__, n);                                                                  \
    }                                                                                                        \
    fmi3Status fmi3Set##Name(fmi3Instance instance, const fmi3ValueReference ref[], size_t n,                \
                             const Type values[], size_t m) {                                                \
        (void)ref;                                                                                           \
        (void)values;                                                                                        \
        (void)m;                                                                                             \
        return none(instance, __func__, n);                                                                  \
    }

OTHER_TYPE(Float32, fmi3Float32)
OTHER_TYPE(Int8, fmi3Int8)
OTHER_TYPE(UInt8, fmi3UInt8)
OTHER_TYPE(Int16, fmi3Int16)
OTHER_TYPE(UInt16, fmi3UInt16)
OTHER_TYPE(Int32, fmi3Int32)
OTHER_TYPE(UInt32, fmi3UInt32)
OTHER_TYPE(Int64, fmi3Int64)
OTHER_TYPE(UInt64, fmi3UInt64)
OTHER_TYPE(Boolean, fmi3Boolean)
OTHER_TYPE(String, fmi3String)

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference ref[], size_t n, size_t sizes[],
                         fmi3Binary values[], size_t m) {
    return none(instance, __func__, n);
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference ref[], size_t n,
                         const size_t sizes[], const fmi3Binary values[], size_t m) {
    return none(instance, __func__, n);
}

fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference ref[], size_t n, fmi3Clock values[]) {
    return none(instance, __func__, n);
}

fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference ref[], size_t n,
                        const fmi3Clock values[]) {
    return none(instance, __func__, n);
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback logMessage) {
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String instantiationToken,
                                               fmi3String resourcePath, fmi3Boolean visible,
                                               fmi3Boolean loggingOn, fmi3InstanceEnvironment environment,
                                               fmi3LogMessageCallback logMessage,
                                               fmi3ClockUpdateCallback clockUpdate,
                                               fmi3LockPreemptionCallback lockPreemption,
                                               fmi3UnlockPreemptionCallback unlockPreemption) {
    return NULL;
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance, fmi3ValueReference ref, size_t *n) {
    return ABSENT(instance, "dependencies of array elements");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent, size_t elements[],
                                       fmi3ValueReference independents[], size_t independentElements[],
                                       fmi3DependencyKind kinds[], size_t n) {
    return ABSENT(instance, "dependencies of array elements");
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance) {
    return ABSENT(instance, "structural parameters");
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance) {
    return ABSENT(instance, "structural parameters");
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
    return ABSENT(instance, "event mode");
}

fmi3Status fmi3EnterStepMode(fmi3Instance instance) {
    return ABSENT(instance, "event mode");
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance) {
    return ABSENT(instance, "event mode");
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *again, fmi3Boolean *terminate,
                                    fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *defined,
                                    fmi3Float64 *next) {
    return ABSENT(instance, "event mode");
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference ref[], size_t n,
                                  fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[]) {
    return ABSENT(instance, "clocks");
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, const fmi3ValueReference ref[], size_t n,
                                   fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                   fmi3IntervalQualifier qualifiers[]) {
    return ABSENT(instance, "clocks");
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance instance, const fmi3ValueReference ref[], size_t n,
                               fmi3Float64 shifts[]) {
    return ABSENT(instance, "clocks");
}

fmi3Status fmi3GetShiftFraction(fmi3Instance instance, const fmi3ValueReference ref[], size_t n,
                                fmi3UInt64 counters[], fmi3UInt64 resolutions[]) {
    return ABSENT(instance, "clocks");
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference ref[], size_t n,
                                  const fmi3Float64 intervals[]) {
    return ABSENT(instance, "clocks");
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance instance, const fmi3ValueReference ref[], size_t n,
                                   const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]) {
    return ABSENT(instance, "clocks");
}

fmi3Status fmi3SetShiftDecimal(fmi3Instance instance, const fmi3ValueReference ref[], size_t n,
                               const fmi3Float64 shifts[]) {
    return ABSENT(instance, "clocks");
}

fmi3Status fmi3SetShiftFraction(fmi3Instance instance, const fmi3ValueReference ref[], size_t n,
                                const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]) {
    return ABSENT(instance, "clocks");
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance instance, fmi3ValueReference clock, fmi3Float64 time) {
    return ABSENT(instance, "model partitions");
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance) {
    return ABSENT(instance, "Model Exchange");
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation) {
    return ABSENT(instance, "Model Exchange");
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time) {
    return ABSENT(instance, "Model Exchange");
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 states[], size_t n) {
    return ABSENT(instance, "Model Exchange");
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[], size_t n) {
    return ABSENT(instance, "Model Exchange");
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 indicators[], size_t n) {
    return ABSENT(instance, "Model Exchange");
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 states[], size_t n) {
    return ABSENT(instance, "Model Exchange");
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[], size_t n) {
    return ABSENT(instance, "Model Exchange");
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *n) {
    return ABSENT(instance, "Model Exchange");
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *n) {
    return ABSENT(instance, "Model Exchange");
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference ref[], size_t n,
                                    const fmi3Int32 orders[], fmi3Float64 values[], size_t m) {
    return ABSENT(instance, "derivatives of outputs");
}
