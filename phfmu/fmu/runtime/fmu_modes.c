/* Ideal switches of a unit: an instance for each mode, of which one is present. Only units with switches have
 * this file. */
#include <stdlib.h>
#include <string.h>

#include "fmu_modes.h"
#include "modes.h"
#include "pool.h"

/* Memory of all modes, owned; a mode's instance has the place of its mode in the table. */
typedef struct world {
    fmu *f;
    ph_modes *modes;
    ph_mode *whole; /* a mode each */
    ph_mode_source source;
    signed char *sides;    /* 1+2n */
    signed char *changed;  /* n */
    signed char *stops;    /* a state event each */
    const ph_mode *failed; /* whose instance refused the last step */
    size_t largest;        /* of their states */
} world;

static const fmu_switches *about(const fmu *f) {
    return f->about->landing->switches;
}

/* Place of a mode in the table, or -1. */
static int find(const fmu_switches *s, const signed char *on) {
    for (int i = 0; i < s->n; i++)
        if (memcmp(s->rows[i].on, on, (size_t)s->switches->n) == 0)
            return i;
    return -1;
}

static const ph_mode_rows *rows_of(void *of, const signed char *on) {
    const world *w = of;
    const int i = find(about(w->f), on);
    return i < 0 ? NULL : &about(w->f)->rows[i];
}

static const ph_mode *mode_of(void *of, const signed char *on) {
    const world *w = of;
    const int i = find(about(w->f), on);
    return i < 0 ? NULL : &w->whole[i];
}

static double most_of(void *of, const signed char *on, const double *a, int j) {
    const world *w = of;
    return ph_mode_held(about(w->f)->switches, rows_of(of, on), a, j);
}

/* The parts of the memory; without `base` it only counts. */
static size_t lay_out(fmu *f, world *w, char *base) {
    const fmu_switches *s = about(f);
    const size_t n = (size_t)s->switches->n;
    ph_pool part = {base, 0};
    ph_take(&part, sizeof(*w));
    w->modes = ph_take(&part, ph_modes_size(s->switches));
    w->whole = ph_take(&part, sizeof(ph_mode) * (size_t)s->n);
    w->sides = ph_take(&part, 1 + 2 * n);
    w->changed = ph_take(&part, n);
    w->stops = ph_take(&part, (size_t)s->switches->nevent);
    return part.used;
}

/* A mode with memory of its own; the first one has the instance that the unit begins with. */
static int make(fmu *f, world *w, int i) {
    const fmu_mode *mode = &about(f)->modes[i];
    const size_t size = i ? ph_padded(ph_size(mode->model)) : 0;
    ph_mode *whole = &w->whole[i];
    int offset[PH_NBLOCK + 1];
    char *memory, *fresh;
    size_t state, landing;
    if (i && size == 0)
        return 0;
    memory = i ? calloc(1, size) : NULL;
    whole->in = i ? (void *)memory : f->of;
    if (!whole->in || (i && ph_init(whole->in, mode->model) != PH_OK))
        return 0;
    ph_initialise(whole->in); /* where it cannot be, entering it says so */
    state = ph_padded(ph_state_size(whole->in));
    landing = ph_landing_size(whole->in, mode->events);
    fresh = calloc(1, state + landing);
    if (!fresh)
        return 0;
    whole->rows = &about(f)->rows[i];
    whole->fresh = fresh;
    ph_save(whole->in, fresh);
    whole->landing = ph_landing_init(fresh + state, whole->in, mode->events);
    ph_land_stops(whole->landing, w->stops);
    ph_layout(mode->model, offset);
    whole->length = offset[PH_NBLOCK];
    w->largest = state > w->largest ? state : w->largest;
    return 1;
}

static void take(fmu *f, const ph_mode *mode) {
    const world *w = f->modes;
    f->of = mode->in;
    f->mode = &about(f)->modes[mode - w->whole];
    ph_layout(f->mode->model, f->offset);
}

/* The unit has the instance of the present mode. */
static void adopt(fmu *f) {
    const world *w = f->modes;
    take(f, ph_modes_present(w->modes));
}

static void begin(world *w) {
    const size_t n = (size_t)about(w->f)->switches->n;
    w->sides[0] = 0;
    memcpy(w->sides + 1, about(w->f)->rows[0].on, n);
    memcpy(w->sides + 1 + n, about(w->f)->rows[0].on, n);
}

int fmu_modes_create(fmu *f) {
    world counted;
    world *w = calloc(1, lay_out(f, &counted, NULL));
    if (!w)
        return 0;
    f->modes = w;
    lay_out(f, w, (char *)w);
    w->f = f;
    w->source = (ph_mode_source){w, rows_of, mode_of, most_of};
    memset(w->stops, 1, (size_t)about(f)->switches->nevent);
    for (int i = 0; i < about(f)->n; i++)
        if (!make(f, w, i))
            return 0;
    begin(w);
    ph_modes_init(w->modes, about(f)->switches, &w->source, w->sides);
    ph_modes_prepare(w->modes, f->about->step);
    adopt(f);
    return fmu_landing_create(f);
}

void fmu_modes_release(fmu *f) {
    world *w = f->modes;
    for (int i = 0; w && i < about(f)->n; i++) {
        if (i)
            free(w->whole[i].in);
        free((void *)(size_t)w->whole[i].fresh);
    }
    free(w);
    fmu_landing_release(f);
}

int fmu_modes_step(fmu *f, double t, double h, int n, int *stopped) {
    world *w = f->modes;
    ph_landed *out = fmu_landing_out(f);
    int status = PH_OK;
    ph_modes_begin(w->modes, t, h, n);
    for (out->done = 0; status == PH_OK && !out->done;) {
        status = ph_modes_on(w->modes, out, w->changed);
        if (status)
            break;
        adopt(f);
        if (!out->events)
            continue;
        fmu_landing_book(f, out);
        if (stopped && !out->done && *out->event_t > t) {
            *stopped = 1;
            break;
        }
    }
    out->done = 0;
    if (status) { /* its report is what the importer is told, before it is taken back */
        w->failed = ph_modes_failed(w->modes);
        take(f, w->failed);
    }
    return status;
}

int fmu_modes_refused(const fmu *f, const char *function) {
    const world *w = f->modes;
    const ph_mode_refusal *r = ph_modes_refusal(w->modes);
    if (r->reason < 0)
        return fmu_event_refused(f, function, ph_land_refusal(w->failed->landing),
                                 f->about->landing->events->n, f->about->landing->names);
    return fmu_mode_refused(f, function, r, about(f)->switches->n, about(f)->names);
}

static size_t sides_size(const fmu *f) {
    return ph_padded(1 + 2 * (size_t)about(f)->switches->n);
}

size_t fmu_modes_state_size(const fmu *f) {
    const world *w = f->modes;
    return sides_size(f) + w->largest;
}

void fmu_modes_save(const fmu *f, void *out) {
    const world *w = f->modes;
    char *place = out;
    memset(out, 0, fmu_modes_state_size(f));
    memcpy(place, w->sides, 1 + 2 * (size_t)about(f)->switches->n);
    ph_save(f->of, place + sides_size(f));
}

int fmu_modes_load(fmu *f, const void *from) {
    world *w = f->modes;
    const signed char *sides = from;
    if (find(about(f), sides + 1) < 0)
        return PH_ARGUMENT;
    memcpy(w->sides, sides, 1 + 2 * (size_t)about(f)->switches->n);
    adopt(f);
    return ph_load(f->of, (const char *)from + sides_size(f));
}

const char *fmu_modes_fault(const fmu *f, const void *from) {
    const world *w = f->modes;
    const int n = about(f)->switches->n, present = find(about(f), (const signed char *)from + 1);
    const signed char *sides = from;
    for (int i = 0; i < 1 + 2 * n; i++)
        if (sides[i] != 0 && sides[i] != 1)
            return "a switch is neither open nor closed";
    if (present < 0)
        return "it is in a mode that the unit does not have";
    return ph_state_fault(w->whole[present].in, (const char *)from + sides_size(f));
}

void fmu_modes_reset(fmu *f) {
    begin(f->modes);
    adopt(f);
}

void fmu_modes_asked(const fmu *f, double *p) {
    const world *w = f->modes;
    const ph_switches *s = about(f)->switches;
    for (int j = 0; j < s->n; j++)
        p[s->place[j]] = w->sides[1 + s->n + j];
}

void fmu_modes_ask(fmu *f, double *p) {
    const world *w = f->modes;
    const ph_switches *s = about(f)->switches;
    for (int j = 0; j < s->n; j++) {
        w->sides[1 + s->n + j] = p[s->place[j]] != 0.0;
        p[s->place[j]] = w->sides[1 + j];
    }
}
