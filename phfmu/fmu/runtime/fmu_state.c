/* Saved states: the token, the mode, the books, impulses and a copy of the model's state, in one block
 * without pointers.
 *
 * Serialized states carry a checksum: they come from files, and damage is found by it. A checksum can be
 * written by anybody, so whatever chooses a place in memory or bounds a loop is compared with the model too,
 * before there is a state that the instance would take. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmu_modes.h"

typedef struct saved {
    char token[FMU_TOKEN + 2];
    unsigned long long size;
    unsigned long long sum; /* of a serialized state, else 0 */
    fmu_phase phase;
} saved;

unsigned long long fmu_hash(unsigned long long hash, const void *bytes, size_t n) {
    const unsigned char *byte = bytes;
    for (size_t i = 0; i < n; i++)
        hash = (hash ^ byte[i]) * 1099511628211ULL;
    return hash;
}

/* FNV-1a of a serialized state; its own place counts as zero. */
static unsigned long long sum_of(const void *bytes, size_t size) {
    saved head;
    memcpy(&head, bytes, sizeof(head));
    head.sum = 0;
    return fmu_hash(fmu_hash(FMU_HASHED, &head, sizeof(head)), (const saved *)bytes + 1, size - sizeof(head));
}

/* Bytes of the books and of the impulses, which lie between the head and the state of the model. */
static size_t books_size(const fmu *f) {
    return FMU_NBOOKS * sizeof(double) * (size_t)f->sizes.ncomp;
}

static size_t impulses_size(const fmu *f) {
    return f->about->impulses ? 4 * sizeof(double) * (size_t)f->about->impulses->n : 0;
}

static const fmu_switches *switches(const fmu *f) {
    return f->about->landing ? f->about->landing->switches : NULL;
}

static size_t model_size(const fmu *f) {
    return switches(f) ? switches(f)->state_size(f) : f->map->state_size(f->of);
}

static int save_model(const fmu *f, void *out) {
    if (!switches(f))
        return f->map->save(f->of, out);
    switches(f)->save(f, out);
    return PH_OK;
}

static char *model_in(const fmu *f, void *state) {
    return (char *)state + sizeof(saved) + books_size(f) + impulses_size(f);
}

size_t fmu_state_size(const fmu *f) {
    return sizeof(saved) + books_size(f) + impulses_size(f) + model_size(f);
}

int fmu_save(fmu *f, const char *function, void **state) {
    saved *to;
    char *place;
    const double *s;
    int n;
    if (fmu_allow(f, function, FMU_ANY) || fmu_given(f, function, state != NULL))
        return FMU_ERROR;
    if (f->map->returns && !f->map->returns(f->about->of) && f->phase.mode != FMU_INSTANTIATED)
        return fmu_refuse(f, "%s: a unit inside cannot save its state", function);
    if (!*state)
        *state = calloc(1, fmu_state_size(f));
    if (!*state)
        return fmu_refuse(f, "%s: no memory for a state (%zu bytes)", function, fmu_state_size(f));
    to = *state;
    memset(to, 0, sizeof(*to));
    memcpy(to->token, f->about->token, FMU_TOKEN);
    to->size = fmu_state_size(f);
    to->phase = f->phase;
    memcpy(to + 1, f->books.start, books_size(f));
    place = (char *)(to + 1) + books_size(f);
    s = fmu_impulse_values(f, &n);
    if (n > 0)
        memcpy(place, s, impulses_size(f));
    return save_model(f, place + impulses_size(f))
               ? fmu_refuse(f, "%s: %s", function, ph_status_text(PH_UNIT))
               : FMU_OK;
}

static int check(const fmu *f, const char *function, const saved *from) {
    if (memcmp(from->token, f->about->token, FMU_TOKEN) == 0 && from->size == fmu_state_size(f))
        return FMU_OK;
    return fmu_refuse(f, "%s: the state (%llu bytes) is not one of this model (%zu bytes)", function,
                      from->size, fmu_state_size(f));
}

int fmu_restore(fmu *f, const char *function, const void *state) {
    const saved *from = state;
    const char *place;
    double *s;
    int status, n;
    if (fmu_allow(f, function, FMU_ANY))
        return FMU_ERROR;
    if (!from)
        return fmu_refuse(f, "%s: there is no state", function);
    if (check(f, function, from))
        return FMU_ERROR;
    place = (const char *)(from + 1) + books_size(f);
    place += impulses_size(f);
    status = switches(f) ? switches(f)->load(f, place) : f->map->load(f->of, place);
    place -= impulses_size(f);
    if (status)
        return fmu_refuse(f, "%s: %s", function, ph_status_text(status));
    memcpy(f->books.start, from + 1, books_size(f));
    s = fmu_impulse_values(f, &n);
    if (n > 0)
        memcpy(s, place, impulses_size(f));
    f->phase = from->phase;
    f->solved = 0.0;
    f->step_known = f->end_known = f->nodes.known = 0;
    return FMU_OK;
}

int fmu_forget(fmu *f, void **state) {
    if (!f)
        return FMU_ERROR;
    if (state) {
        if (*state && f->map->forget)
            f->map->forget(f->of, model_in(f, *state));
        free(*state);
        *state = NULL;
    }
    return FMU_OK;
}

/* With what units inside keep of it, which stands behind it. */
int fmu_written_size(fmu *f, const char *function, void *state, size_t *size) {
    size_t held = 0;
    if (fmu_allow(f, function, FMU_ANY) || fmu_given(f, function, size != NULL))
        return FMU_ERROR;
    if (state && f->map->held_size && f->map->held_size(f->of, model_in(f, state), &held))
        return fmu_refuse(f, "%s: %s", function, ph_status_text(PH_UNIT));
    *size = fmu_state_size(f) + held;
    return FMU_OK;
}

int fmu_write(fmu *f, const char *function, void *state, void *bytes, size_t size) {
    const size_t own = f ? fmu_state_size(f) : 0;
    saved head;
    size_t all;
    if (fmu_allow(f, function, FMU_ANY) || fmu_given(f, function, state && bytes) ||
        fmu_written_size(f, function, state, &all))
        return FMU_ERROR;
    if (size < all)
        return fmu_refuse(f, "%s: %zu bytes given, the state has %zu", function, size, all);
    memcpy(bytes, state, own);
    if (f->map->write_held && f->map->write_held(f->of, model_in(f, bytes), (char *)bytes + own))
        return fmu_refuse(f, "%s: %s", function, ph_status_text(PH_UNIT));
    memcpy(&head, bytes, sizeof(head));
    head.sum = sum_of(bytes, all);
    memcpy(bytes, &head, sizeof(head));
    return FMU_OK;
}

/* What is wrong in the phase of a state, or NULL. */
static const char *phase_fault(const fmu *f, const fmu_phase *p) {
    const double numbers[] = {p->start, p->steps, p->happened[0], p->happened[1], p->happened[2]};
    if (p->mode != FMU_INSTANTIATED && p->mode != FMU_INITIALIZATION && p->mode != FMU_STEP &&
        p->mode != FMU_TERMINATED)
        return "there is no such mode";
    if (p->passed < 0 || p->passed > f->about->nevent)
        return "it counts events that the unit does not have";
    if ((p->stop_defined & ~1) || (p->crossed & ~1))
        return "a flag is neither 0 nor 1";
    if (p->stop_defined && !(p->stop >= p->start))
        return "its stop time lies before its start";
    for (size_t i = 0; i < sizeof(numbers) / sizeof(*numbers); i++)
        if (!isfinite(numbers[i]))
            return "a time or a count is not finite";
    return p->steps >= 0.0 ? NULL : "a count is negative";
}

/* The same of a whole state, aligned for double. */
static const char *fault(const fmu *f, const saved *from) {
    const char *place = (const char *)(from + 1) + books_size(f);
    const double *impulses = (const double *)(const void *)place;
    const char *found = phase_fault(f, &from->phase);
    place += impulses_size(f);
    for (size_t i = 0; i < impulses_size(f) / sizeof(double); i++)
        if (!isfinite(impulses[i]))
            return "an impulse is not finite";
    if (found)
        return found;
    return switches(f) ? switches(f)->fault(f, place) : f->map->state_fault(f->of, place);
}

/* What was checked into *state, which is reused if there is one. */
static void hand_over(const fmu *f, void *checked, size_t size, void **state) {
    if (!*state) {
        *state = checked;
        return;
    }
    if (f->map->forget)
        f->map->forget(f->of, model_in(f, *state));
    memcpy(*state, checked, size);
    free(checked);
}

int fmu_read(fmu *f, const char *function, const void *bytes, size_t size, void **state) {
    const size_t own = f ? fmu_state_size(f) : 0;
    saved head, *copy;
    const char *wrong;
    if (fmu_allow(f, function, FMU_ANY) || fmu_given(f, function, state && bytes))
        return FMU_ERROR;
    if (size < own || (size > own && !f->map->read_held))
        return fmu_refuse(f, "%s: %zu bytes given, the state has %zu", function, size, own);
    memcpy(&head, bytes, sizeof(head));
    if (check(f, function, &head))
        return FMU_ERROR;
    if (head.sum != sum_of(bytes, size))
        return fmu_refuse(f, "%s: the state is damaged, its checksum does not fit", function);
    copy = malloc(own);
    if (!copy)
        return fmu_refuse(f, "%s: no memory for a state (%zu bytes)", function, own);
    head.sum = 0;
    memcpy(copy, bytes, own);
    memcpy(copy, &head, sizeof(head));
    wrong = fault(f, copy);
    if (!wrong && f->map->read_held &&
        f->map->read_held(f->of, model_in(f, copy), (const char *)bytes + own, size - own))
        wrong = "a unit inside refuses its part";
    if (wrong) {
        free(copy);
        return fmu_refuse(f, "%s: the state is none that this unit wrote: %s", function, wrong);
    }
    hand_over(f, copy, own, state);
    return FMU_OK;
}
