/* Memory of an instance: one block from its making to its end. */
#include "fmu.h"
#include "pool.h"

#include <stdlib.h>
#include <string.h>

static fmu *allocate(const fmu_interface *about, const char *name) {
    const ph_step_map *map = about->map();
    ph_sizes sizes;
    const ph_sizes *p = &sizes;
    const size_t model = map->size(about->of), length = strlen(name) + 1;
    const size_t scalars = about->sizes ? 2 * (size_t)about->nvariable : 0;
    size_t nu, nc, values;
    char *block;
    fmu *f;
    double *place;
    if (model == 0)
        return NULL;
    map->sizes(about->of, &sizes);
    nu = (size_t)p->nu;
    nc = (size_t)p->ncomp;
    values = (size_t)p->nx + 2 * (size_t)p->np + nu * (size_t)p->k + 2 * nu * nu + (FMU_NBOOKS + 1) * nc +
             (about->along_room ? about->along_room(about, p) : 0);
    block = calloc(1, ph_padded(sizeof(fmu)) + ph_padded(model) + sizeof(double) * values +
                          sizeof(unsigned) * scalars + length);
    if (!block)
        return NULL;
    f = (fmu *)(void *)block;
    f->about = about;
    f->map = map;
    f->sizes = sizes;
    f->of = block + ph_padded(sizeof(fmu));
    place = (double *)(void *)(block + ph_padded(sizeof(fmu)) + ph_padded(model));
    f->x = place;
    f->p = f->x + p->nx;
    f->u = f->p + p->np;
    f->step_derivative = f->u + nu * (size_t)p->k;
    f->end_derivative = f->step_derivative + nu * nu;
    f->books.start = f->end_derivative + nu * nu;
    f->books.booked = f->books.start + nc;
    f->books.rest = f->books.booked + nc;
    f->books.jumped = f->books.rest + nc;
    f->books.before = f->books.jumped + nc;
    f->old = f->books.before + nc;
    f->direction = f->old + p->np;
    place += values;
    if (scalars)
        f->scalars = (unsigned *)(void *)place;
    f->name = (char *)place + sizeof(unsigned) * scalars;
    memcpy(f->name, name, length);
    return f;
}

/* What a part of the map says of a call that it refuses. */
static void say(void *with, const char *text) {
    fmu_refuse(with, "%s", text);
}

fmu *fmu_create(const char *name, const char *token, const char *resources, int logging, fmu_sink sink,
                void (*callback)(void), void *environment) {
    const fmu_interface *about = &fmu_the_interface;
    fmu nobody = {.logging = logging, .sink = sink, .callback = callback, .environment = environment};
    ph_surroundings around;
    fmu *f;
    nobody.name = name ? (char *)name : "";
    if (!*nobody.name) {
        fmu_refuse(&nobody, "the name of an instance must not be empty");
        return NULL;
    }
    if (!token || strcmp(token, about->token) != 0) {
        fmu_refuse(&nobody, "the model description has the token '%s', this library belongs to '%s'",
                   token ? token : "", about->token);
        return NULL;
    }
    f = allocate(about, name);
    if (!f || f->map->init(f->of, about->of) != PH_OK || (about->node_memory && !about->node_memory(f))) {
        size_t size = about->map()->size(about->of);
        fmu_refuse(&nobody, "%s (instance of %zu bytes)", size ? "no memory" : ph_status_text(PH_ABI), size);
        fmu_free(f);
        return NULL;
    }
    f->logging = logging;
    f->sink = sink;
    f->callback = callback;
    f->environment = environment;
    f->phase.mode = FMU_INSTANTIATED;
    ph_places(&f->sizes, f->offset);
    around = (ph_surroundings){resources, f->name, say, f};
    if ((f->map->open && f->map->open(f->of, &around)) || fmu_events_create(f)) {
        fmu_free(f);
        return NULL;
    }
    return f;
}

void fmu_free(fmu *f) {
    if (f) {
        fmu_events_free(f);
        if (f->map->release)
            f->map->release(f->of);
        free(f->nodes.memory);
    }
    free(f);
}
