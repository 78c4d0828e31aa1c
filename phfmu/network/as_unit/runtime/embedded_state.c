/* Saved states: what the unit keeps itself, and the values beside it. */
#include <math.h>
#include <string.h>

#include "embedded.h"
#include "pool.h"

/* A saved state: a state that the unit keeps, and the values. */
typedef struct saved {
    void *state;
    int begun;
    int started;
} saved;

size_t ph_embedded_state_size(const void *of) {
    return ph_padded(sizeof(saved)) + sizeof(double) * (size_t)((const ph_embedded_unit *)of)->nvalue;
}

int ph_embedded_returns(const void *about) {
    return ((const ph_embedded_about *)about)->saves;
}

int ph_embedded_save(void *of, void *out) {
    ph_embedded_unit *e = of;
    saved *to = out;
    int status = PH_OK;
    if (e->begun) {
        e->unit.state = &to->state;
        status = e->about->saves ? ph_embedded_asked(e, e->unit.version->save(&e->unit)) : PH_UNIT;
        e->unit.state = &e->state;
    }
    to->begun = e->begun && status == PH_OK;
    memcpy((char *)out + ph_padded(sizeof(saved)), e->values, sizeof(double) * (size_t)e->nvalue);
    return status;
}

int ph_embedded_load(void *of, const void *from) {
    ph_embedded_unit *e = of;
    saved head;
    int status = PH_OK;
    memcpy(&head, from, sizeof(head));
    if (head.begun) {
        e->unit.state = &head.state;
        status = ph_embedded_asked(e, e->unit.version->restore(&e->unit));
        e->unit.state = &e->state;
        e->started = 1;
    }
    e->begun = head.begun && status == PH_OK;
    e->moved = e->lost = 0;
    memcpy(e->values, (const char *)from + ph_padded(sizeof(saved)), sizeof(double) * (size_t)e->nvalue);
    return status;
}

void ph_embedded_forget(void *of, void *state) {
    saved *from = state;
    if (from->state)
        ((ph_embedded_unit *)of)->standard->forget(of, &from->state);
}

int ph_embedded_held_size(void *of, void *state, size_t *n) {
    ph_embedded_unit *e = of;
    const saved *from = state;
    *n = 0;
    if (!from->state)
        return PH_OK;
    if (!e->about->serialises)
        return ph_embedded_refuse(e, "the unit inside cannot write its state as bytes");
    return ph_embedded_asked(e, e->standard->size(e, from->state, n));
}

/* What is written names no place in memory. */
int ph_embedded_write_held(void *of, void *state, char *bytes) {
    saved *from = state;
    size_t n;
    int status = ph_embedded_held_size(of, state, &n);
    if (status == PH_OK && from->state)
        status = ph_embedded_asked(of, ((ph_embedded_unit *)of)->standard->write(of, from->state, bytes, n));
    from->state = NULL;
    return status;
}

int ph_embedded_read_held(void *of, void *state, const char *bytes, size_t n) {
    saved *to = state;
    to->state = NULL;
    if (n == 0)
        return to->begun ? PH_VALUE : PH_OK;
    if (!((ph_embedded_unit *)of)->about->serialises)
        return PH_VALUE;
    return ph_embedded_asked(of, ((ph_embedded_unit *)of)->standard->read(of, bytes, n, &to->state));
}

const char *ph_embedded_state_fault(const void *of, const void *from) {
    const ph_embedded_unit *e = of;
    const double *values = (const double *)(const void *)((const char *)from + ph_padded(sizeof(saved)));
    return isfinite(values[1 + e->offset[PH_TIME]]) ? NULL : "the time of a unit inside is not finite";
}
