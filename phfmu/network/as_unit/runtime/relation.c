/* Members that are ideal switches and nothing else, as step maps. */
#include "relation.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "network_whole.h"
#include "system.h"

typedef struct relation {
    const ph_relation *about;
    int offset[PH_NBLOCK + 1];
    int n;          /* values that are its state: those from the table to u */
    double *memory; /* owned: what all below are in */
    double *table;
    double *row[PH_NROW];
    double *p;
    double *u;    /* k*(nu+na): inputs at nodes */
    double *y;    /* k*(nu+na): outputs there */
    double *kept; /* n */
} relation;

static double *block(const relation *r, int b) {
    return r->table + r->offset[b];
}

/* B in the present mode. */
static const double *matrix(const relation *r) {
    const ph_relation *a = r->about;
    size_t mode = 0;
    for (int j = 0; j < a->n; j++)
        mode |= (size_t)(r->p[a->place[j]] != 0.0) << j;
    return a->B + mode * (size_t)(a->na * a->nu);
}

/* y = B^T a, entry after entry. */
static void outputs(const relation *r, const double *a, double *y) {
    const double *B = matrix(r);
    const int nu = r->about->nu;
    for (int i = 0; i < nu; i++) {
        y[i] = 0.0;
        for (int j = 0; j < r->about->na; j++)
            y[i] += a[j] * B[j * nu + i];
    }
}

static double sum(const double *values, int n) {
    double all = n ? values[0] : 0.0;
    for (int i = 1; i < n; i++)
        all += values[i];
    return all;
}

static void fill(double *to, double value, int n) {
    for (int i = 0; i < n; i++)
        to[i] = value;
}

static void present(const relation *r) {
    outputs(r, block(r, PH_A_END), block(r, PH_Y_END));
}

void ph_relation_tell(void *of, double t, const double *a, const double *observables) {
    const relation *r = of;
    *block(r, PH_TIME) = t;
    for (int j = 0; j < r->about->na; j++)
        block(r, PH_A_END)[j] = a[r->about->at[j]];
    for (int j = 0; j < r->about->nobs; j++)
        block(r, PH_OBSERVABLES)[j] = observables[r->about->observed[j]];
    present(r);
}

const double *ph_relation_unknowns(const void *of) {
    return block(of, PH_A_END);
}

void ph_relation_clear(void *of) {
    const relation *r = of;
    for (int i = 0; i < PH_NROW; i++)
        ph_clear(r->row[i], i == PH_ROW_PAIRS ? r->about->nu : r->about->ncomp);
}

/* Books a step under the inputs at nodes. */
static int step(const ph_share *s, double t, double h) {
    relation *r = s->of;
    const ph_relation *about = r->about;
    const int nu = about->nu, width = nu + about->na, nc = about->ncomp;
    double *pairs = r->row[PH_ROW_PAIRS], *mean = block(r, PH_Y_STEP), *a = block(r, PH_A), supplied;
    ph_copy(r->u, s->u, about->k * width);
    ph_relation_clear(r);
    ph_clear(mean, nu);
    ph_clear(a, about->na);
    for (int m = 0; m < about->k; m++) {
        const double b = about->weights[m], *u = r->u + m * width;
        double *y = r->y + m * width;
        outputs(r, u + nu, y);
        for (int i = 0; i < nu; i++) {
            pairs[i] += b * (u[i] * y[i]);
            mean[i] += b * y[i];
        }
        for (int j = 0; j < about->na; j++)
            a[j] += b * u[nu + j];
    }
    for (int i = 0; i < nu; i++) {
        pairs[i] *= h;
        block(r, PH_ENERGY)[i] += pairs[i];
    }
    fill(r->row[PH_ROW_SUPPLIED], sum(pairs, nu), nc);
    supplied = sum(block(r, PH_ENERGY), nu);
    fill(block(r, PH_SUPPLIED), supplied, nc);
    fill(block(r, PH_RESIDUAL), -supplied, nc);
    *block(r, PH_TIME) = t + h;
    return PH_OK;
}

/* -- the step map -----------------------------------------------------------------------------------------
 */

static void sizes(const void *about, ph_sizes *s) {
    const ph_relation *a = about;
    *s = (ph_sizes){.na = a->na,
                    .nu = a->nu,
                    .nq = a->nu,
                    .np = a->np,
                    .nobs = a->nobs,
                    .ncomp = a->ncomp,
                    .k = a->k,
                    .weights = a->weights};
}

static size_t size(const void *about) {
    (void)about;
    return sizeof(relation);
}

static double *taken(double **from, int n) {
    double *to = *from;
    *from += n;
    return to;
}

static int reset(void *of) {
    relation *r = of;
    const double t = *block(r, PH_TIME);
    ph_clear(r->table, r->n);
    *block(r, PH_TIME) = t;
    ph_copy(r->p, r->about->p, r->about->np);
    ph_copy(block(r, PH_A_END), r->about->a, r->about->na);
    present(r);
    return PH_OK;
}

static int init(void *memory, const void *about) {
    relation *r = memory;
    const ph_relation *a = about;
    const int nodes = a->k * (a->nu + a->na);
    ph_sizes s;
    double *place;
    memset(r, 0, sizeof(*r));
    r->about = a;
    sizes(about, &s);
    ph_places(&s, r->offset);
    r->n = r->offset[PH_NBLOCK] + PH_ROW_PAIRS * a->ncomp + a->nu + a->np + nodes;
    r->memory = calloc((size_t)(2 * r->n + nodes) + 1, sizeof(double));
    if (!r->memory)
        return PH_ABI;
    place = r->memory;
    r->table = taken(&place, r->offset[PH_NBLOCK]);
    for (int i = 0; i < PH_NROW; i++)
        r->row[i] = taken(&place, i == PH_ROW_PAIRS ? a->nu : a->ncomp);
    r->p = taken(&place, a->np);
    r->u = taken(&place, nodes);
    r->y = taken(&place, nodes);
    r->kept = taken(&place, r->n);
    return reset(r);
}

static void release(void *of) {
    free(((relation *)of)->memory);
}

/* Means take the values of the instant. */
static int initialise(void *of) {
    const relation *r = of;
    ph_copy(block(r, PH_Y_STEP), block(r, PH_Y_END), r->about->nu);
    ph_copy(block(r, PH_A), block(r, PH_A_END), r->about->na);
    return PH_OK;
}

static int refresh(void *of) {
    (void)of;
    return PH_OK;
}

static int skip(void *of, double t) {
    *block(of, PH_TIME) = t;
    return PH_OK;
}

static int set_x(void *of, double t, const double *x) {
    (void)x;
    return skip(of, t);
}

static int set_parameters(void *of, const double *p) {
    const relation *r = of;
    for (int i = 0; i < r->about->np; i++)
        if (!isfinite(p[i]))
            return PH_VALUE;
    ph_copy(r->p, p, r->about->np);
    present(r);
    return PH_OK;
}

/* What it is under inputs now, it is told. */
static int set_input(void *of, const double *u) {
    (void)of;
    (void)u;
    return PH_OK;
}

static const double *signals(const void *of) {
    return ((const relation *)of)->table;
}

static const double *ledger(const void *of, int row) {
    return ((const relation *)of)->row[row];
}

static const double *parameters(const void *of) {
    return ((const relation *)of)->p;
}

static const double *input(const void *of) {
    return ((const relation *)of)->u;
}

static const double *node_outputs(const void *of) {
    return ((const relation *)of)->y;
}

static const long long *counts(const void *of) {
    static const long long none[PH_NCOUNT];
    (void)of;
    return none;
}

static const ph_report *report(const void *of) {
    static const ph_report nothing = {.row = -1, .column = -1};
    (void)of;
    return &nothing;
}

/* Rows of the ledger, then means, of steps that are told as one. */
static int kept_size(const void *about) {
    const ph_relation *a = about;
    return PH_ROW_PAIRS * a->ncomp + 2 * a->nu + a->na;
}

static int rows(const relation *r) {
    return PH_ROW_PAIRS * r->about->ncomp + r->about->nu;
}

static void keep_rows(const void *of, double *kept) {
    const relation *r = of;
    ph_copy(kept, r->row[0], rows(r));
    ph_copy(kept + rows(r), block(r, PH_Y_STEP), r->about->nu);
    ph_copy(kept + rows(r) + r->about->nu, block(r, PH_A), r->about->na);
}

static void mean(double *to, const double *kept, int n, double part) {
    for (int i = 0; i < n; i++)
        to[i] = part * kept[i] + (1.0 - part) * to[i];
}

static void join(void *of, const double *kept, double part) {
    const relation *r = of;
    for (int i = 0; i < rows(r); i++)
        r->row[0][i] += kept[i];
    mean(block(r, PH_Y_STEP), kept + rows(r), r->about->nu, part);
    mean(block(r, PH_A), kept + rows(r) + r->about->nu, r->about->na, part);
}

static size_t state_size(const void *of) {
    return sizeof(double) * (size_t)((const relation *)of)->n;
}

static int save(void *of, void *out) {
    memcpy(out, ((const relation *)of)->table, state_size(of));
    return PH_OK;
}

static int load(void *of, const void *from) {
    memcpy(((const relation *)of)->table, from, state_size(of));
    return PH_OK;
}

static const char *state_fault(const void *of, const void *from) {
    const double *values = from;
    for (int i = 0; i < ((const relation *)of)->n; i++)
        if (!isfinite(values[i]))
            return "a value of a switch is not finite";
    return NULL;
}

const ph_step_map *ph_map_relation(void) {
    static const ph_step_map map = {
        .sizes = sizes,
        .size = size,
        .init = init,
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
    };
    return &map;
}

/* -- what the master asks of its share ---------------------------------------------------------------------
 */

static int keep(const ph_share *s) {
    const relation *r = s->of;
    ph_copy(r->kept, r->table, r->n);
    return PH_OK;
}

static int restore(const ph_share *s) {
    const relation *r = s->of;
    ph_copy(r->table, r->kept, r->n);
    return PH_OK;
}

static int nothing(const ph_share *s) {
    (void)s;
    return PH_OK;
}

/* What its rows follow from is in the rows of the junctions. */
static int along(const ph_share *s) {
    const int all = s->ninput + 2 * s->nbare;
    ph_clear(s->dy, all * s->k * s->nu);
    ph_clear(s->dend, all * s->nu);
    return PH_OK;
}

static int record(const ph_share *s, double *to) {
    (void)s;
    (void)to;
    return PH_OK;
}

const ph_kind *ph_kind_relation(void) {
    static const ph_kind kind = {keep,  restore, step,   nothing, nothing, nothing,
                                 along, nothing, record, nothing, nothing, NULL};
    return &kind;
}
