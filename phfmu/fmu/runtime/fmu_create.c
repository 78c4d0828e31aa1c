/* Memory of an instance: one block from its making to its end. */
#include "fmu.h"
#include "pool.h"

#include <stdlib.h>
#include <string.h>

static fmu *allocate(const fmu_interface *about, const char *name) {
    const ph_plan *p = about->model->step;
    const size_t model = ph_size(about->model), length = strlen(name) + 1, nu = (size_t)p->nu;
    const size_t nc = (size_t)p->ncomp;
    const size_t values =
        (size_t)p->nx + 2 * (size_t)p->np + nu * (size_t)p->k + 2 * nu * nu + (FMU_NBOOKS + 1) * nc;
    const size_t scalars = about->sizes ? 2 * (size_t)about->nvariable : 0;
    char *block;
    fmu *f;
    double *place;
    if (model == 0)
        return NULL;
    block = calloc(1, ph_padded(sizeof(fmu)) + ph_padded(model) + sizeof(double) * values +
                          sizeof(unsigned) * scalars + length);
    if (!block)
        return NULL;
    f = (fmu *)(void *)block;
    f->about = about;
    f->in = (ph_instance *)(void *)(block + ph_padded(sizeof(fmu)));
    place = (double *)(void *)(block + ph_padded(sizeof(fmu)) + ph_padded(model));
    f->x = place;
    f->p = f->x + p->nx;
    f->u = f->p + p->np;
    f->step_map = f->u + nu * (size_t)p->k;
    f->end_map = f->step_map + nu * nu;
    f->books.start = f->end_map + nu * nu;
    f->books.booked = f->books.start + nc;
    f->books.rest = f->books.booked + nc;
    f->books.jumped = f->books.rest + nc;
    f->books.before = f->books.jumped + nc;
    f->old = f->books.before + nc;
    if (scalars)
        f->scalars = (unsigned *)(void *)(f->old + p->np);
    f->name = (char *)(f->old + p->np) + sizeof(unsigned) * scalars;
    memcpy(f->name, name, length);
    return f;
}

fmu *fmu_create(const char *name, const char *token, int logging, fmu_sink sink, void (*callback)(void),
                void *environment) {
    const fmu_interface *about = &fmu_the_interface;
    fmu nobody = {.logging = logging, .sink = sink, .callback = callback, .environment = environment};
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
    if (!f || ph_init(f->in, about->model) != PH_OK || (about->node_memory && !about->node_memory(f))) {
        size_t size = ph_size(about->model);
        fmu_refuse(&nobody, "%s (instance of %zu bytes)", size ? "no memory" : ph_status_text(PH_ABI), size);
        free(f);
        return NULL;
    }
    f->logging = logging;
    f->sink = sink;
    f->callback = callback;
    f->environment = environment;
    f->phase.mode = FMU_INSTANTIATED;
    ph_layout(about->model, f->offset);
    if (fmu_events_create(f)) {
        fmu_free(f);
        return NULL;
    }
    return f;
}

void fmu_free(fmu *f) {
    if (f) {
        free(f->nodes.memory);
        fmu_events_free(f);
    }
    free(f);
}
