/* A unit of another tool as a step map: reader.py and port_values.py in C, with the same calls in the same
 * order. */
#include "embedded.h"

#include <fenv.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "system.h"

static int get(ph_embedded_unit *e, const ph_scalars *s) {
    return s->n ? ph_embedded_asked(e, e->unit.version->get(&e->unit, s)) : PH_OK;
}

static int set(ph_embedded_unit *e, const ph_scalars *s) {
    return s->n ? ph_embedded_asked(e, e->unit.version->set(&e->unit, s)) : PH_OK;
}

/* Outputs and displacements now, inward. */
int ph_embedded_look(ph_embedded_unit *e, double *to) {
    const ph_scalars *s = &e->looked;
    const int status = get(e, s);
    for (int i = 0; i < s->n && status == PH_OK; i++)
        to[s->at[i]] = s->value[s->place[i]] * s->sign[i];
    return status;
}

/* -- the step map -----------------------------------------------------------------------------------------
 */

static void sizes(const void *about, ph_sizes *s) {
    const ph_embedded_about *a = about;
    static const double one = 1.0;
    *s = (ph_sizes){.nu = a->nu,
                    .nq = a->nu,
                    .np = a->np,
                    .nobs = a->told.n + a->nother,
                    .ncomp = 1,
                    .k = 1,
                    .weights = &one};
}

static size_t size(const void *about) {
    (void)about;
    return sizeof(ph_embedded_unit);
}

/* Values of the rows of the ledger, which stand one behind the other: a pair for each input, else one. */
static int rows_of(const ph_embedded_about *a) {
    return PH_NROW - 1 + a->nu;
}

static double *taken(double **from, int n) {
    double *to = *from;
    *from += n;
    return to;
}

static void furnish(ph_scalars *s, const ph_scalars *about, double **memory) {
    *s = *about;
    s->value = taken(memory, about->nvalue);
}

static int set_now(ph_embedded_unit *e, int i, double value);
static int reset(void *of);

static int init(void *memory, const void *about) {
    ph_embedded_unit *e = memory;
    const ph_embedded_about *a = about;
    ph_sizes s;
    double *place;
    memset(e, 0, sizeof(*e));
    e->about = a;
    e->standard = a->standard();
    sizes(about, &s);
    ph_places(&s, e->offset);
    e->nvalue = 1 + e->offset[PH_NBLOCK] + rows_of(a) + a->np + a->nu + a->nlooked + a->nu;
    e->memory = calloc((size_t)(2 * e->nvalue + a->input.nvalue + a->looked.nvalue + a->told.nvalue +
                                a->sent.nvalue + 2 * a->nlooked + a->nu + 1),
                       sizeof(double));
    e->readers = calloc((size_t)a->nother + 1, sizeof(*e->readers));
    if (!e->memory || !e->readers)
        return PH_ABI;
    place = e->values = e->memory;
    e->h = taken(&place, 1);
    e->table = taken(&place, e->offset[PH_NBLOCK]);
    for (int i = 0; i < PH_NROW; i++)
        e->row[i] = taken(&place, i == PH_ROW_PAIRS ? a->nu : 1);
    e->p = taken(&place, a->np);
    e->given = taken(&place, a->nu);
    e->after = taken(&place, a->nlooked);
    e->supplied = taken(&place, a->nu);
    e->kept = taken(&place, e->nvalue);
    furnish(&e->input, &a->input, &place);
    furnish(&e->looked, &a->looked, &place);
    furnish(&e->told, &a->told, &place);
    furnish(&e->sent, &a->sent, &place);
    e->now = taken(&place, a->nlooked);
    e->third = taken(&place, a->nlooked);
    e->again = taken(&place, a->nu);
    e->unit.version = e->standard->version();
    e->unit.functions = &e->functions;
    e->unit.state = &e->state;
    e->unit.no_set_prior = a->no_set_prior;
    return reset(e);
}

static int started(ph_embedded_unit *e, const ph_surroundings *around) {
    const size_t room = strlen(around->name) + strlen(e->about->member) + strlen(e->folder) + 20;
    char *name = malloc(room), *resources = malloc(room);
    int status = PH_UNIT;
    if (name && resources) {
        snprintf(name, room, "%s.%s", around->name, e->about->member);
        snprintf(resources, room, "%s/resources", e->folder);
        status = e->standard->begin(e, name, resources);
        if (status)
            ph_embedded_refuse(e, "the unit inside does not start%s%s", *e->words ? ": " : "", e->words);
    }
    free(name);
    free(resources);
    return status;
}

/* Its folder is the one of its name. What its library does to the arithmetic of the process is undone. */
static int open(void *of, const ph_surroundings *around) {
    ph_embedded_unit *e = of;
    char *resources;
    fenv_t arithmetic;
    int status;
    e->around = *around;
    if (!around->resources)
        return ph_embedded_refuse(
            e, "the importer has not told where the resources are, which the unit inside is in");
    resources = ph_path_of(around->resources);
    e->folder = resources ? malloc(strlen(resources) + strlen(e->about->member) + 2) : NULL;
    if (e->folder)
        sprintf(e->folder, "%s/%s", resources, e->about->member);
    free(resources);
    if (!e->folder)
        return ph_embedded_refuse(e, "there is no memory");
    fegetenv(&arithmetic);
    status = ph_embedded_library(e);
    if (status == PH_OK)
        status = e->standard->bind(e);
    for (int i = 0; i < e->about->nother && status == PH_OK; i++)
        status = e->standard->find(e, &e->about->other[i], &e->readers[i]);
    if (status == PH_OK)
        status = started(e, around);
    fesetenv(&arithmetic);
    return status;
}

/* After a fatal error it is not called any more, and what it has stays. */
static void release(void *of) {
    ph_embedded_unit *e = of;
    const int dead = ph_unit_dead(&e->unit);
    if (e->unit.instance && !dead) {
        if (e->state)
            e->standard->forget(e, &e->state);
        e->standard->end(e);
    }
    if (!dead)
        ph_embedded_unload(e);
    free(e->readers);
    free(e->life);
    free(e->folder);
    free(e->memory);
}

static int reset(void *of) {
    ph_embedded_unit *e = of;
    const ph_embedded_about *a = e->about;
    const double t = e->table[e->offset[PH_TIME]];
    ph_clear(e->values, e->nvalue);
    e->table[e->offset[PH_TIME]] = t;
    memcpy(e->p, a->start, sizeof(double) * (size_t)a->np);
    e->begun = e->moved = e->lost = 0;
    return PH_OK;
}

/* Outputs of ports now, in the table; displacements stand behind them. */
int ph_embedded_look_now(ph_embedded_unit *e) {
    const int status = ph_embedded_look(e, e->now);
    if (status == PH_OK)
        memcpy(e->table + e->offset[PH_Y_END], e->now, sizeof(double) * (size_t)e->about->nu);
    return status;
}

/* A value that its function has written. */
static double number(ph_type type, const void *value) {
    switch (type) {
    case PH_INT8:
        return *(const int8_t *)value;
    case PH_UINT8:
        return *(const uint8_t *)value;
    case PH_INT16:
        return *(const int16_t *)value;
    case PH_UINT16:
        return *(const uint16_t *)value;
    case PH_INT32:
        return *(const int32_t *)value;
    case PH_UINT32:
        return *(const uint32_t *)value;
    case PH_INT64:
        return (double)*(const int64_t *)value;
    case PH_UINT64:
        return (double)*(const uint64_t *)value;
    case PH_FLOAT32:
        return *(const float *)value;
    default:
        return *(const bool *)value;
    }
}

/* All that it tells. */
int ph_embedded_refresh(void *of) {
    ph_embedded_unit *e = of;
    const ph_scalars *s = &e->told;
    double *to = e->table + e->offset[PH_OBSERVABLES];
    int status;
    if (!e->begun)
        return PH_OK;
    status = ph_embedded_look_now(e);
    if (status == PH_OK)
        status = get(e, s);
    for (int i = 0; i < s->n && status == PH_OK; i++)
        to[s->at[i]] = s->value[s->place[i]];
    for (int i = 0; i < e->about->nother && status == PH_OK; i++) {
        const ph_typed *other = &e->about->other[i];
        union {
            uint64_t room;
            float single;
        } value = {0};
        status = ph_embedded_asked(e, e->standard->get(e, other, e->readers[i], &value));
        to[s->n + i] = number(other->type, &value);
    }
    return status;
}

/* Parameters that are not as the unit has them anyway. */
static int set_starts(ph_embedded_unit *e) {
    const ph_embedded_about *a = e->about;
    int status = PH_OK;
    for (int i = 0; i < a->np && status == PH_OK; i++)
        if (a->given[i] || e->p[i] != a->start[i])
            status = set_now(e, i, e->p[i]);
    for (int i = 0; i < a->ntyped && status == PH_OK; i++)
        status = ph_embedded_asked(e, e->standard->set(e, &a->typed[i]));
    return status;
}

static int set_now(ph_embedded_unit *e, int i, double value) {
    ph_scalars one = e->about->settable[i];
    one.value = &value;
    return set(e, &one);
}

static int initialise(void *of) {
    ph_embedded_unit *e = of;
    const ph_embedded_about *a = e->about;
    fenv_t arithmetic;
    int status = PH_OK;
    if (e->begun)
        return PH_OK;
    fegetenv(&arithmetic);
    if (e->started)
        status = ph_embedded_asked(e, e->standard->reset(e));
    e->started = 1;
    if (status == PH_OK)
        status = ph_embedded_asked(e, e->standard->enter(e, e->table[e->offset[PH_TIME]]));
    if (status == PH_OK)
        status = set_starts(e);
    if (status == PH_OK)
        status = ph_embedded_asked(e, e->standard->leave(e));
    fesetenv(&arithmetic);
    for (int i = 0; i < a->nu; i++)
        e->given[i] = a->begin[i] / a->input.sign[i];
    if (status == PH_OK)
        status = ph_embedded_look(e, e->after);
    memcpy(e->table + e->offset[PH_Y_STEP], e->after, sizeof(double) * (size_t)a->nu);
    e->begun = status == PH_OK;
    return status ? status : ph_embedded_refresh(e);
}

/* It has no states that are known; time alone is set. */
static int set_x(void *of, double t, const double *x) {
    ph_embedded_unit *e = of;
    (void)x;
    e->table[e->offset[PH_TIME]] = t;
    e->begun = 0;
    return PH_OK;
}

/* What may be set late is; for all others it begins anew. */
static int set_parameters(void *of, const double *p) {
    ph_embedded_unit *e = of;
    int status = PH_OK;
    for (int i = 0; i < e->about->np && status == PH_OK; i++) {
        if (e->p[i] == p[i])
            continue;
        e->p[i] = p[i];
        if (e->begun && e->about->late[i])
            status = set_now(e, i, p[i]);
        else
            e->begun = 0;
    }
    return status;
}

int ph_embedded_give(ph_embedded_unit *e) {
    const ph_scalars *s = &e->input;
    for (int i = 0; i < s->n; i++)
        s->value[s->place[i]] = e->given[s->at[i]];
    return set(e, s);
}

int ph_embedded_set_input(void *of, const double *u) {
    ph_embedded_unit *e = of;
    for (int i = 0; i < e->about->nu; i++) {
        if (!isfinite(u[i]))
            return PH_VALUE;
        e->given[i] = u[i] / e->about->input.sign[i];
    }
    return ph_embedded_give(e);
}

int ph_embedded_tell(ph_embedded_unit *e, double *to) {
    const ph_scalars *s = &e->sent;
    const int status = get(e, s);
    for (int i = 0; i < s->n && status == PH_OK; i++)
        to[s->at[i]] = s->value[s->place[i]];
    return status;
}

int ph_embedded_take(ph_embedded_unit *e, const double *values) {
    int status = PH_OK;
    for (int i = 0; i < e->about->ntaken && status == PH_OK; i++) {
        const int at = e->about->taken[i];
        e->p[at] = values[i];
        status = set_now(e, at, values[i]);
    }
    return status;
}

static int skip(void *of, double t) {
    ph_embedded_unit *e = of;
    e->table[e->offset[PH_TIME]] = t;
    return PH_OK;
}

static const double *signals(const void *of) {
    return ((const ph_embedded_unit *)of)->table;
}

static const double *ledger(const void *of, int row) {
    return ((const ph_embedded_unit *)of)->row[row];
}

static const double *parameters(const void *of) {
    return ((const ph_embedded_unit *)of)->p;
}

static const double *input(const void *of) {
    return ((const ph_embedded_unit *)of)->given;
}

static const double *node_outputs(const void *of) {
    const ph_embedded_unit *e = of;
    return e->table + e->offset[PH_Y_STEP];
}

static const long long *counts(const void *of) {
    static const long long none[PH_NCOUNT];
    (void)of;
    return none;
}

static const ph_report *report(const void *of) {
    return &((const ph_embedded_unit *)of)->report;
}

/* Rows of the ledger, then means, of steps that are told as one. */
static int kept_size(const void *about) {
    const ph_embedded_about *a = about;
    return rows_of(a) + a->nu;
}

static void keep_rows(const void *of, double *kept) {
    const ph_embedded_unit *e = of;
    const size_t n = (size_t)rows_of(e->about);
    memcpy(kept, e->row[0], sizeof(double) * n);
    memcpy(kept + n, e->table + e->offset[PH_Y_STEP], sizeof(double) * (size_t)e->about->nu);
}

static void join(void *of, const double *kept, double part) {
    ph_embedded_unit *e = of;
    const int n = rows_of(e->about);
    double *mean = e->table + e->offset[PH_Y_STEP];
    for (int i = 0; i < n; i++)
        e->row[0][i] += kept[i];
    for (int i = 0; i < e->about->nu; i++)
        mean[i] = part * kept[n + i] + (1.0 - part) * mean[i];
}

const ph_step_map *ph_map_embedded(void) {
    static const ph_step_map map = {
        .sizes = sizes,
        .size = size,
        .init = init,
        .open = open,
        .release = release,
        .reset = reset,
        .initialise = initialise,
        .refresh = ph_embedded_refresh,
        .set_x = set_x,
        .set_parameters = set_parameters,
        .set_input = ph_embedded_set_input,
        .set_node_inputs = ph_embedded_set_input,
        .skip = skip,
        .signals = signals,
        .ledger = ledger,
        .parameters = parameters,
        .input = input,
        .node_outputs = node_outputs,
        .counts = counts,
        .report = report,
        .kept_size = kept_size,
        .keep = keep_rows,
        .join = join,
        .state_size = ph_embedded_state_size,
        .save = ph_embedded_save,
        .load = ph_embedded_load,
        .state_fault = ph_embedded_state_fault,
        .returns = ph_embedded_returns,
        .forget = ph_embedded_forget,
        .held_size = ph_embedded_held_size,
        .write_held = ph_embedded_write_held,
        .read_held = ph_embedded_read_held,
    };
    return &map;
}
