/* FMI 2.0 for Co-Simulation. */
#include "fmi2Functions.h"

#include "fmu.h"

#define STATUS(call) ((fmi2Status)(call))

const char *fmi2GetTypesPlatform(void) {
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void) {
    return fmi2Version;
}

/* The standard passes messages through printf: the text is complete, so a percent sign is doubled. */
static void sink(const fmu *f, int status, const char *category, const char *text) {
    fmi2CallbackLogger logger = (fmi2CallbackLogger)f->callback;
    char safe[2048];
    size_t to = 0;
    for (; *text && to + 2 < sizeof(safe); text++) {
        if (*text == '%' || *text == '#')
            safe[to++] = *text;
        safe[to++] = *text;
    }
    safe[to] = '\0';
    logger(f->environment, f->name, STATUS(status), category, safe);
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn) {
    (void)visible;
    if (fmuType != fmi2CoSimulation || !functions)
        return NULL;
    /* here loggingOn is about messages for debugging; why a call was refused is told until somebody objects
     */
    return fmu_create(instanceName, fmuGUID, fmuResourceLocation, loggingOn ? FMU_LOG_ALL : FMU_LOG_ERRORS,
                      sink, (void (*)(void))functions->logger, functions->componentEnvironment);
}

void fmi2FreeInstance(fmi2Component c) {
    fmu_free(c);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[]) {
    return STATUS(fmu_log(c, __func__, loggingOn, nCategories, categories));
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real startTime, fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
    (void)toleranceDefined; /* equations are solved to rounding */
    (void)tolerance;
    return STATUS(fmu_setup(c, __func__, startTime, stopTimeDefined, stopTime));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    return STATUS(fmu_enter(c, __func__));
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    return STATUS(fmu_leave(c, __func__));
}

fmi2Status fmi2Terminate(fmi2Component c) {
    return STATUS(fmu_terminate(c, __func__));
}

fmi2Status fmi2Reset(fmi2Component c) {
    return STATUS(fmu_reset(c, __func__));
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[]) {
    return STATUS(fmu_get(c, __func__, vr, nvr, value));
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[]) {
    return STATUS(fmu_set(c, __func__, vr, nvr, value));
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    return STATUS(fmu_save(c, __func__, FMUstate));
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate) {
    return STATUS(fmu_restore(c, __func__, FMUstate));
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    return STATUS(fmu_forget(c, FMUstate));
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
    return STATUS(fmu_written_size(c, __func__, FMUstate, size));
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[],
                                 size_t size) {
    return STATUS(fmu_write(c, __func__, FMUstate, serializedState, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate) {
    return STATUS(fmu_read(c, __func__, serializedState, size, FMUstate));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[],
                                        size_t nUnknown, const fmi2ValueReference vKnown_ref[], size_t nKnown,
                                        const fmi2Real dvKnown[], fmi2Real dvUnknown[]) {
    return STATUS(
        fmu_derivative(c, __func__, 0, vUnknown_ref, nUnknown, vKnown_ref, nKnown, dvKnown, dvUnknown));
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
    (void)noSetFMUStatePriorToCurrentPoint;
    return STATUS(fmu_do_step(c, __func__, currentCommunicationPoint, communicationStepSize, NULL));
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value) {
    if (!c || !value || s != fmi2LastSuccessfulTime)
        return fmi2Discard;
    *value = fmu_time(c) + ((const fmu *)c)->solved; /* the unit itself is where the step began */
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value) {
    if (!c || !value || s != fmi2Terminated)
        return fmi2Discard;
    *value = fmi2False;
    return fmi2OK;
}

/* What this unit has not: variables of other types, asynchronous steps, derivatives of signals. */

static fmi2Status none(fmi2Component c, const char *function, size_t n) {
    if (n == 0 && c)
        return fmi2OK;
    return STATUS(fmu_refuse(c, "%s: all variables are of the type Real", function));
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[]) {
    (void)vr;
    (void)value;
    return none(c, __func__, nvr);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[]) {
    (void)vr;
    (void)value;
    return none(c, __func__, nvr);
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[]) {
    (void)vr;
    (void)value;
    return none(c, __func__, nvr);
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          const fmi2Integer value[]) {
    (void)vr;
    (void)value;
    return none(c, __func__, nvr);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          const fmi2Boolean value[]) {
    (void)vr;
    (void)value;
    return none(c, __func__, nvr);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                         const fmi2String value[]) {
    (void)vr;
    (void)value;
    return none(c, __func__, nvr);
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    (void)vr;
    (void)nvr;
    (void)order;
    (void)value;
    return STATUS(fmu_refuse(c, "%s: inputs are held over a step", __func__));
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[]) {
    (void)vr;
    (void)nvr;
    (void)order;
    (void)value;
    return STATUS(fmu_refuse(c, "%s: derivatives of outputs are not provided", __func__));
}

fmi2Status fmi2CancelStep(fmi2Component c) {
    return STATUS(fmu_refuse(c, "%s: steps are never pending", __func__));
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value) {
    (void)c;
    (void)s;
    (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value) {
    (void)c;
    (void)s;
    (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value) {
    (void)c;
    (void)s;
    (void)value;
    return fmi2Discard;
}
