/* Saved states: the token, the mode and a copy of the model's state, in one block without pointers. */
#include <stdlib.h>
#include <string.h>

#include "fmu.h"

typedef struct saved {
    char token[FMU_TOKEN + 2];
    unsigned long long size;
    fmu_phase phase;
} saved;

size_t fmu_state_size(const fmu *f) {
    return sizeof(saved) + ph_state_size(f->in);
}

int fmu_save(fmu *f, const char *function, void **state) {
    saved *to;
    if (fmu_allow(f, function, FMU_ANY))
        return FMU_ERROR;
    if (!*state)
        *state = malloc(fmu_state_size(f));
    if (!*state)
        return fmu_refuse(f, "%s: no memory for a state (%zu bytes)", function, fmu_state_size(f));
    to = *state;
    memset(to, 0, sizeof(*to));
    memcpy(to->token, f->about->token, FMU_TOKEN);
    to->size = fmu_state_size(f);
    to->phase = f->phase;
    ph_save(f->in, to + 1);
    return FMU_OK;
}

static int check(const fmu *f, const char *function, const saved *from) {
    if (memcmp(from->token, f->about->token, FMU_TOKEN) == 0 && from->size == fmu_state_size(f))
        return FMU_OK;
    return fmu_refuse(f, "%s: the state (%llu bytes) is not one of this model (%zu bytes)", function,
                      from->size, fmu_state_size(f));
}

int fmu_restore(fmu *f, const char *function, const void *state) {
    const saved *from = state;
    int status;
    if (fmu_allow(f, function, FMU_ANY))
        return FMU_ERROR;
    if (!from)
        return fmu_refuse(f, "%s: there is no state", function);
    if (check(f, function, from))
        return FMU_ERROR;
    status = ph_load(f->in, from + 1);
    if (status)
        return fmu_refuse(f, "%s: %s", function, ph_status_text(status));
    f->phase = from->phase;
    f->step_known = f->end_known = 0;
    return FMU_OK;
}

int fmu_forget(fmu *f, void **state) {
    if (!f)
        return FMU_ERROR;
    if (state) {
        free(*state);
        *state = NULL;
    }
    return FMU_OK;
}

int fmu_write(fmu *f, const char *function, const void *state, void *bytes, size_t size) {
    if (fmu_allow(f, function, FMU_ANY))
        return FMU_ERROR;
    if (!state || size < fmu_state_size(f))
        return fmu_refuse(f, "%s: %zu bytes given, the state has %zu", function, size, fmu_state_size(f));
    memcpy(bytes, state, fmu_state_size(f));
    return FMU_OK;
}

int fmu_read(fmu *f, const char *function, const void *bytes, size_t size, void **state) {
    saved head;
    if (fmu_allow(f, function, FMU_ANY))
        return FMU_ERROR;
    if (size != fmu_state_size(f))
        return fmu_refuse(f, "%s: %zu bytes given, the state has %zu", function, size, fmu_state_size(f));
    memcpy(&head, bytes, sizeof(head));
    if (check(f, function, &head))
        return FMU_ERROR;
    if (!*state)
        *state = malloc(size);
    if (!*state)
        return fmu_refuse(f, "%s: no memory for a state (%zu bytes)", function, size);
    memcpy(*state, bytes, size);
    return FMU_OK;
}
