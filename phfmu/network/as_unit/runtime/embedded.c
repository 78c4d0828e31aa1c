/* A unit of another tool as a step map and as a share of the master: called_share.py, fmu_member.py and the
 * estimate of unit_books.py in C, with the same calls in the same order. */
#include "embedded.h"

#include <fenv.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "system.h"

/* -- calls ------------------------------------------------------------------------------------------------
 */

static const char *answer_of(int status) {
    static const char *const words[] = {"ok", "warning", "discard", "error", "fatal", "pending"};
    return status >= 0 && status < 6 ? words[status] : "an unknown status";
}

/* What was answered to the call that was refused, with the unit's own words. */
static int refused(ph_embedded_unit *e) {
    const double t = e->table[e->offset[PH_TIME]];
    e->report = (ph_report){.status = PH_UNIT, .row = -1, .column = -1, .time = t};
    return ph_embedded_refuse(e, "at t = %.9g s %s was answered with %s%s%s", t,
                              e->unit.refused ? e->unit.refused : "a call", answer_of(e->unit.answer),
                              *e->words ? ": " : "", e->words);
}

static int asked(ph_embedded_unit *e, int status) {
    return status ? refused(e) : PH_OK;
}

static int get(ph_embedded_unit *e, const ph_scalars *s) {
    return s->n ? asked(e, e->unit.version->get(&e->unit, s)) : PH_OK;
}

static int set(ph_embedded_unit *e, const ph_scalars *s) {
    return s->n ? asked(e, e->unit.version->set(&e->unit, s)) : PH_OK;
}

/* -- books ------------------------------------------------------------------------------------------------
 */

/* Outputs and displacements now, inward. */
static int look(ph_embedded_unit *e, double *to) {
    const ph_scalars *s = &e->looked;
    const int status = get(e, s);
    for (int i = 0; i < s->n && status == PH_OK; i++)
        to[s->at[i]] = s->value[s->place[i]] * s->sign[i];
    return status;
}

static double sum(const double *values, int n) {
    double found = 0.0;
    for (int i = 0; i < n; i++)
        found += values[i];
    return found;
}

/* Energy that the held inputs supplied in a step of length h, by the change of what the outputs are the rates
 * of, else by the trapezoid of the outputs; `after`: at its end. */
static void book(ph_embedded_unit *e, double h, const double *after) {
    const ph_embedded_about *a = e->about;
    double *mean = e->table + e->offset[PH_Y_STEP], *through = e->table + e->offset[PH_ENERGY];
    double *pair = e->row[PH_ROW_PAIRS], supplied;
    for (int i = 0; i < a->nu; i++) {
        const int q = a->rate[i];
        mean[i] = q >= 0 && h != 0.0 ? (after[q] - e->after[q]) / h : (e->after[i] + after[i]) / 2.0;
        pair[i] = h * (a->input.sign[i] * e->given[i]) * mean[i];
    }
    memcpy(e->after, after, sizeof(double) * (size_t)a->nlooked);
    for (int i = 0; i < a->nu; i++)
        through[i] = e->supplied[i] += pair[i];
    supplied = sum(pair, a->nu);
    *e->row[PH_ROW_STORED] = *e->row[PH_ROW_SUPPLIED] = supplied;
    *e->row[PH_ROW_MOVED] = fabs(sum(e->supplied, a->nu));
    e->table[e->offset[PH_SUPPLIED]] = e->table[e->offset[PH_H]] = sum(e->supplied, a->nu);
}

/* -- the step map -----------------------------------------------------------------------------------------
 */

static void sizes(const void *about, ph_sizes *s) {
    const ph_embedded_about *a = about;
    static const double one = 1.0;
    *s = (ph_sizes){
        .nu = a->nu, .nq = a->nu, .np = a->np, .nobs = a->told.n, .ncomp = 1, .k = 1, .weights = &one};
}

static size_t size(const void *about) {
    (void)about;
    return sizeof(ph_embedded_unit);
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
    e->nvalue = 1 + e->offset[PH_NBLOCK] + 5 + a->nu + a->np + a->nu + a->nlooked + a->nu;
    e->memory = calloc((size_t)(2 * e->nvalue + a->input.nvalue + a->looked.nvalue + a->told.nvalue +
                                a->nlooked + a->nu + 1),
                       sizeof(double));
    if (!e->memory)
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
    e->now = taken(&place, a->nlooked);
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
    status = ph_embedded_load(e);
    if (status == PH_OK)
        status = e->standard->bind(e);
    if (status == PH_OK)
        status = started(e, around);
    fesetenv(&arithmetic);
    return status;
}

static void release(void *of) {
    ph_embedded_unit *e = of;
    if (e->unit.instance) {
        if (e->state)
            e->standard->forget(e, &e->state);
        e->standard->end(e);
    }
    ph_embedded_unload(e);
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

/* Outputs of ports now, and the energy. */
static int look_now(ph_embedded_unit *e) {
    const ph_scalars *s = &e->looked;
    const int status = get(e, s);
    for (int i = 0; i < s->n && status == PH_OK; i++)
        if (s->at[i] < e->about->nu)
            e->table[e->offset[PH_Y_END] + s->at[i]] = s->value[s->place[i]] * s->sign[i];
    return status;
}

/* All that it tells. */
static int refresh(void *of) {
    ph_embedded_unit *e = of;
    const ph_scalars *s = &e->told;
    double *to = e->table + e->offset[PH_OBSERVABLES];
    int status;
    if (!e->begun)
        return PH_OK;
    status = look_now(e);
    if (status == PH_OK)
        status = get(e, s);
    for (int i = 0; i < s->n && status == PH_OK; i++)
        to[s->at[i]] = s->value[s->place[i]];
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
        status = asked(e, e->standard->set(e, &a->typed[i]));
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
        status = asked(e, e->standard->reset(e));
    e->started = 1;
    if (status == PH_OK)
        status = asked(e, e->standard->enter(e, e->table[e->offset[PH_TIME]]));
    if (status == PH_OK)
        status = set_starts(e);
    if (status == PH_OK)
        status = asked(e, e->standard->leave(e));
    fesetenv(&arithmetic);
    for (int i = 0; i < a->nu; i++)
        e->given[i] = a->begin[i] / a->input.sign[i];
    if (status == PH_OK)
        status = look(e, e->after);
    memcpy(e->table + e->offset[PH_Y_STEP], e->after, sizeof(double) * (size_t)a->nu);
    e->begun = status == PH_OK;
    return status ? status : refresh(e);
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

static int give(ph_embedded_unit *e) {
    const ph_scalars *s = &e->input;
    for (int i = 0; i < s->n; i++)
        s->value[s->place[i]] = e->given[s->at[i]];
    return set(e, s);
}

static int set_input(void *of, const double *u) {
    ph_embedded_unit *e = of;
    for (int i = 0; i < e->about->nu; i++) {
        if (!isfinite(u[i]))
            return PH_VALUE;
        e->given[i] = u[i] / e->about->input.sign[i];
    }
    return give(e);
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
    return 5 + 2 * ((const ph_embedded_about *)about)->nu;
}

static void keep_rows(const void *of, double *kept) {
    const ph_embedded_unit *e = of;
    const size_t n = 5 + (size_t)e->about->nu;
    memcpy(kept, e->row[0], sizeof(double) * n);
    memcpy(kept + n, e->table + e->offset[PH_Y_STEP], sizeof(double) * (size_t)e->about->nu);
}

static void join(void *of, const double *kept, double part) {
    ph_embedded_unit *e = of;
    const int nu = e->about->nu;
    double *mean = e->table + e->offset[PH_Y_STEP];
    for (int i = 0; i < 5 + nu; i++)
        e->row[0][i] += kept[i];
    for (int i = 0; i < nu; i++)
        mean[i] = part * kept[5 + nu + i] + (1.0 - part) * mean[i];
}

/* A saved state: a state that the unit keeps, and the values. */
typedef struct saved {
    void *state;
    int begun;
    int started;
} saved;

static size_t state_size(const void *of) {
    return ph_padded(sizeof(saved)) + sizeof(double) * (size_t)((const ph_embedded_unit *)of)->nvalue;
}

static int returns(const void *about) {
    return ((const ph_embedded_about *)about)->saves;
}

static int save(void *of, void *out) {
    ph_embedded_unit *e = of;
    saved *to = out;
    int status = PH_OK;
    if (e->begun) {
        e->unit.state = &to->state;
        status = e->about->saves ? asked(e, e->unit.version->save(&e->unit)) : PH_UNIT;
        e->unit.state = &e->state;
    }
    to->begun = e->begun && status == PH_OK;
    memcpy((char *)out + ph_padded(sizeof(saved)), e->values, sizeof(double) * (size_t)e->nvalue);
    return status;
}

static int load(void *of, const void *from) {
    ph_embedded_unit *e = of;
    saved head;
    int status = PH_OK;
    memcpy(&head, from, sizeof(head));
    if (head.begun) {
        e->unit.state = &head.state;
        status = asked(e, e->unit.version->restore(&e->unit));
        e->unit.state = &e->state;
        e->started = 1;
    }
    e->begun = head.begun && status == PH_OK;
    e->moved = e->lost = 0;
    memcpy(e->values, (const char *)from + ph_padded(sizeof(saved)), sizeof(double) * (size_t)e->nvalue);
    return status;
}

static void forget(void *of, void *state) {
    saved *from = state;
    if (from->state)
        ((ph_embedded_unit *)of)->standard->forget(of, &from->state);
}

static int held_size(void *of, void *state, size_t *n) {
    ph_embedded_unit *e = of;
    const saved *from = state;
    *n = 0;
    if (!from->state)
        return PH_OK;
    if (!e->about->serialises)
        return ph_embedded_refuse(e, "the unit inside cannot write its state as bytes");
    return asked(e, e->standard->size(e, from->state, n));
}

/* What is written names no place in memory. */
static int write_held(void *of, void *state, char *bytes) {
    saved *from = state;
    size_t n;
    int status = held_size(of, state, &n);
    if (status == PH_OK && from->state)
        status = asked(of, ((ph_embedded_unit *)of)->standard->write(of, from->state, bytes, n));
    from->state = NULL;
    return status;
}

static int read_held(void *of, void *state, const char *bytes, size_t n) {
    saved *to = state;
    to->state = NULL;
    if (n == 0)
        return to->begun ? PH_VALUE : PH_OK;
    if (!((ph_embedded_unit *)of)->about->serialises)
        return PH_VALUE;
    return asked(of, ((ph_embedded_unit *)of)->standard->read(of, bytes, n, &to->state));
}

static const char *state_fault(const void *of, const void *from) {
    const ph_embedded_unit *e = of;
    const double *values = (const double *)(const void *)((const char *)from + ph_padded(sizeof(saved)));
    return isfinite(values[1 + e->offset[PH_TIME]]) ? NULL : "the time of a unit inside is not finite";
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
        .refresh = refresh,
        .set_x = set_x,
        .set_parameters = set_parameters,
        .set_input = set_input,
        .set_node_inputs = set_input,
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
        .state_size = state_size,
        .save = save,
        .load = load,
        .state_fault = state_fault,
        .returns = returns,
        .forget = forget,
        .held_size = held_size,
        .write_held = write_held,
        .read_held = read_held,
    };
    return &map;
}

/* -- the share of the master ------------------------------------------------------------------------------
 */

static int keep(const ph_share *s) {
    ph_embedded_unit *e = s->of;
    memcpy(e->kept, e->values, sizeof(double) * (size_t)e->nvalue);
    e->moved = 0;
    return e->about->saves ? asked(e, e->unit.version->save(&e->unit)) : PH_OK;
}

static int back(ph_embedded_unit *e) {
    int status = PH_OK;
    if (e->about->saves)
        status = asked(e, e->unit.version->restore(&e->unit));
    else
        e->lost = e->lost || e->moved;
    memcpy(e->values, e->kept, sizeof(double) * (size_t)e->nvalue);
    e->moved = 0;
    return status;
}

static int restore(const ph_share *s) {
    return back(s->of);
}

/* Under the inputs that it has. */
static int advance(ph_embedded_unit *e, double t, double h) {
    double *looked = e->now;
    fenv_t arithmetic;
    int status;
    if (e->lost)
        return ph_embedded_refuse(e, "it was refused a step before and cannot save its state: start again");
    status = look(e, e->after);
    if (status)
        return status;
    e->moved = 1;
    fegetenv(&arithmetic);
    status = asked(e, e->unit.version->step(&e->unit, t, h));
    fesetenv(&arithmetic);
    if (status == PH_OK)
        status = look(e, looked);
    for (int i = 0; i < e->about->nlooked && status == PH_OK; i++)
        if (!isfinite(looked[i]))
            return ph_embedded_refuse(e, "an output of its ports is not finite at t = %.9g s", t + h);
    if (status)
        return status;
    e->table[e->offset[PH_TIME]] = t + h;
    *e->h = h;
    book(e, h, looked);
    return PH_OK;
}

static int step(const ph_share *s, double t, double h) {
    ph_embedded_unit *e = s->of;
    int status;
    e->report = (ph_report){.status = PH_UNIT, .row = -1, .column = -1, .time = t, .h = h};
    e->unit.time = t;
    e->unit.length = h;
    status = set_input(e, s->u);
    return status ? status : advance(e, t, h);
}

int ph_embedded_finish(void *of) {
    ph_embedded_unit *e = of;
    const size_t inputs = sizeof(double) * (size_t)e->about->nu;
    int status;
    memcpy(e->again, e->given, inputs);
    status = back(e);
    memcpy(e->given, e->again, inputs);
    if (status == PH_OK)
        status = give(e);
    e->unit.no_set_prior = 1;
    if (status == PH_OK)
        status = advance(e, e->unit.time, e->unit.length);
    e->unit.no_set_prior = e->about->no_set_prior;
    return status;
}

static int share_refresh(const ph_share *s) {
    return look_now(s->of);
}

static int none(const ph_share *s) {
    (void)s;
    return PH_OK;
}

static int along(const ph_share *s) {
    (void)s;
    return PH_NO_SENSITIVITY;
}

static int present(const ph_share *s) {
    return set_input(s->of, s->now);
}

static int record(const ph_share *s, double *to) {
    ph_embedded_unit *e = s->of;
    const int status = refresh(e);
    (void)to;
    for (int i = 0; i < e->about->nwatched && status == PH_OK; i++)
        if (!isfinite(e->table[e->offset[PH_OBSERVABLES] + e->about->watched[i]]))
            return ph_embedded_refuse(e, "an output is not finite at t = %.9g s",
                                      e->table[e->offset[PH_TIME]]);
    return status;
}

/* It takes no impulses, and signals that are held are not exchanged in units. */
const ph_kind *ph_kind_embedded(void) {
    static const ph_kind kind = {keep,  restore, step,   share_refresh, none, none,
                                 along, present, record, none,          none, NULL};
    return &kind;
}
