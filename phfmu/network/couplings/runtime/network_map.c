/* The step map of coupled members: what is asked of the whole is asked of each, steps are those of the
 * master.
 */
#include <math.h>

#include "network_whole.h"
#include "system.h"

/* Steps whose lengths differ by less than this part, what a clock's rounding makes of equal ones, go on from
 * each other. */
#define SAME 1e-9

static size_t size(const void *about) {
    const ph_network *n = about;
    for (int i = 0; i < n->nmember; i++)
        if (n->members[i].model && ph_size(n->members[i].model) == 0)
            return 0;
    return sizeof(ph_whole);
}

/* What comes is not the continuation of the last step, and the start is another one. */
void ph_whole_changed(ph_whole *w) {
    *w->h = 0.0;
    ph_master_forget(&w->master);
    w->begun = w->sampled = w->held.known = 0;
    w->set = 1;
}

/* The parameter that a wire ends at as the member has it, until it is sampled. */
static void take_start(const ph_whole *w, int wire) {
    const int target = w->held.target[wire], i = w->held.taken[wire];
    const ph_network_member *m = &w->about->members[target];
    w->shares[target].taken[i] = w->p[w->members[target].p + (m->unit ? m->unit->taken : m->native.taken)[i]];
}

static int reset(void *of) {
    ph_whole *w = of;
    const ph_network *n = w->about;
    int status = PH_OK;
    for (int i = 0; i < n->nmember && status == PH_OK; i++) {
        status = w->members[i].map->reset(w->members[i].of);
        if (w->members[i].kicks)
            memset(w->members[i].native.values, 0, ph_whole_values_size(w, i));
    }
    ph_copy(w->free, n->free, w->sizes.nu);
    ph_copy(w->mean, n->start, w->master.ncolumn);
    ph_clear(w->joined, ph_whole_njoined(n, w->sizes.nu));
    ph_whole_changed(w);
    ph_whole_gather_parameters(w);
    ph_whole_gather(w);
    for (int i = 0; i < w->held.n; i++)
        if (w->held.taken[i] >= 0)
            take_start(w, i);
    if (status == PH_OK && w->lander && n->lander->reset)
        status = n->lander->reset(w->lander);
    return status;
}

/* Members that have files beside the library find them in the folders of their names. */
static int open(void *of, const ph_surroundings *around) {
    const ph_whole *w = of;
    int status = PH_OK;
    for (int i = 0; i < w->about->nmember && status == PH_OK; i++)
        if (w->members[i].map->open)
            status = w->members[i].map->open(w->members[i].of, around);
    return status;
}

static int init(void *memory, const void *about) {
    ph_whole *w = memory;
    memset(w, 0, sizeof(*w));
    w->about = about;
    w->master = w->about->master;
    ph_whole_sizes(about, &w->sizes);
    ph_places(&w->sizes, w->offset);
    return ph_whole_make(w) ? reset(w) : PH_ABI;
}

static const ph_report *report_of(const ph_whole *w, int i) {
    return w->members[i].map->report(w->members[i].of);
}

/* Who refused, and why. */
int ph_whole_refused(ph_whole *w, int status, double t, double h) {
    const ph_master *m = &w->master;
    const int n = m->nxi + m->nbare;
    double worst = 0.0;
    w->part = w->about->nmember;
    w->report = (ph_report){.status = status, .row = -1, .column = -1, .time = t, .h = h};
    for (int i = 0; i < m->nshare; i++)
        if (m->status[i]) {
            w->part = i;
            w->report = *report_of(w, i);
            return status;
        }
    w->report.iterations = w->report.spent = m->trials[0];
    for (int i = 0; i < n; i++) {
        const double scaled = fabs(m->rows[i]) / (m->size[i] + m->least[i]);
        if (!(scaled <= worst)) {
            worst = scaled;
            w->report.row = i < m->nxi ? m->column[i] : m->bare_column[i - m->nxi];
        }
    }
    w->report.residual = worst;
    return status;
}

static double time_of(const ph_whole *w) {
    return w->members[0].map->signals(w->members[0].of)[w->members[0].offset[PH_TIME]];
}

/* Inputs as they are before the first step: common variables at `begin` in all of the step, signals as their
 * sources tell them. */
int ph_whole_present(ph_whole *w, const double *begin) {
    ph_master *m = &w->master;
    int status = PH_OK;
    ph_master_spread(m, begin);
    for (int i = 0; i < w->about->nmember && status == PH_OK; i++) {
        const ph_share *s = &w->shares[i];
        ph_share_inputs(m, s, s->u);
        ph_copy(s->now, s->u, s->nu);
        status = w->members[i].map->set_input(w->members[i].of, s->now);
    }
    for (int i = 0; i < m->nwire && status == PH_OK; i++) {
        const ph_share *from = &w->shares[m->wire_source[i]], *to = &w->shares[m->wire_target[i]];
        const int input = m->wire_input[i];
        status = from->kind->refresh(from);
        to->now[input] = m->factor[i] * from->end[m->wire_output[i]] + to->free[input];
        if (status == PH_OK)
            status = to->kind->present(to);
    }
    return status;
}

/* The matrix has other entries, and factors of its own. */
int ph_whole_enter(ph_whole *w, int number) {
    const ph_junction_rows *rows = &w->about->rows[number];
    ph_master *m = &w->master;
    if (w->about->nrows == 0 || m->colptr == rows->colptr)
        return PH_OK;
    if (rows->nnz == 0)
        return PH_SINGULAR;
    m->nskew = rows->nskew;
    m->nnz = rows->nnz;
    m->capacity = rows->capacity;
    m->skew_row = rows->skew_row;
    m->skew_col = rows->skew_col;
    m->skew_entry = rows->skew_entry;
    m->skew = rows->skew;
    m->colptr = rows->colptr;
    m->rowind = rows->rowind;
    m->order = rows->order;
    m->prefer = rows->prefer;
    for (int i = 0; i < w->about->nmember; i++)
        w->shares[i].entry = rows->entry[i];
    ph_master_lu_init(m);
    return PH_OK;
}

/* Held signals as their sources tell them, where no step is taken. */
static int sample(ph_whole *w) {
    const int status = ph_held_sample(&w->master);
    w->sampled = status == PH_OK;
    if (w->held.n)
        ph_whole_gather_parameters(w);
    return status;
}

static int refresh(void *of) {
    ph_whole *w = of;
    int status = PH_OK;
    for (int i = 0; i < w->about->nmember && status == PH_OK; i++) {
        status = w->members[i].map->refresh(w->members[i].of);
        if (status) {
            w->part = i;
            w->report = *report_of(w, i);
        }
    }
    ph_whole_gather(w);
    return status;
}

static int has_units(const ph_network *n) {
    int found = 0;
    for (int i = 0; i < n->nmember; i++)
        found |= n->members[i].unit != NULL;
    return found;
}

/* Of all members, under the inputs that they have. */
static int initialise_members(ph_whole *w) {
    for (int i = 0; i < w->about->nmember; i++) {
        const int status = w->members[i].map->initialise(w->members[i].of);
        if (status) {
            w->part = i;
            w->report = *report_of(w, i);
            return status;
        }
    }
    return PH_OK;
}

/* Means of inputs are those of the instant. */
static void begin_means(const ph_whole *w) {
    for (int i = 0; i < w->about->nmember; i++)
        ph_copy(w->joined + w->master.ncolumn + w->members[i].u, w->shares[i].now, w->members[i].sizes.nu);
}

/* The same as below where those who land tell the start. */
static int begin_landed(ph_whole *w, double t) {
    const int status = w->about->lander->start(w->lander, t);
    if (status) {
        w->part = w->about->nmember;
        w->report = (ph_report){.status = status, .row = -1, .column = -1, .time = t};
        return status;
    }
    ph_copy(w->joined, w->mean, w->master.ncolumn);
    begin_means(w);
    w->begun = 1;
    ph_whole_gather_parameters(w);
    ph_whole_gather(w);
    return PH_OK;
}

/* The junctions where no step has ended, and all values under them. */
static int initialise(void *of) {
    ph_whole *w = of;
    const ph_network *n = w->about;
    double *begin = w->joined; /* means are those of the start */
    const double t = time_of(w);
    int status;
    if (w->begun)
        return PH_OK;
    status = initialise_members(w);
    if (status)
        return status;
    if (n->lander && n->lander->start)
        return begin_landed(w, t);
    status = ph_whole_present(w, n->start);
    if (status == PH_OK)
        status = sample(w);
    if (status == PH_OK)
        status = refresh(w);
    if (status)
        return status;
    ph_master_forget(&w->master);
    status = ph_master_prepare(&w->master, t, n->step, n->trials, n->start, w->mean, begin);
    ph_master_forget(&w->master);
    if (status)
        return ph_whole_refused(w, status, t, n->step);
    status = ph_whole_present(w, begin);
    if (status == PH_OK)
        status = initialise_members(w);
    if (status == PH_OK && !has_units(n))
        status = sample(w);
    begin_means(w);
    w->begun = status == PH_OK;
    ph_whole_gather(w);
    return status;
}

static int set_x(void *of, double t, const double *x) {
    ph_whole *w = of;
    const int begin = w->offset[PH_X];
    for (int i = 0; i < w->about->nmember; i++) {
        const ph_whole_member *m = &w->members[i];
        const int status = m->map->set_x(m->of, t, x + m->first[PH_X] - begin);
        if (status)
            return status;
    }
    ph_whole_changed(w);
    ph_whole_gather(w);
    return PH_OK;
}

static int set_parameters(void *of, const double *p) {
    ph_whole *w = of;
    for (int i = 0; i < w->sizes.np; i++)
        if (!isfinite(p[i]))
            return PH_VALUE;
    if (w->sizes.np == 0 || memcmp(w->p, p, sizeof(double) * ((size_t)w->sizes.np)) == 0)
        return PH_OK;
    for (int i = 0; i < w->about->nmember; i++) {
        const int status = w->members[i].map->set_parameters(w->members[i].of, p + w->members[i].p);
        if (status)
            return status;
    }
    ph_whole_changed(w);
    ph_whole_gather_parameters(w);
    return PH_OK;
}

/* Those of junctions are not among them. */
static int set_input(void *of, const double *u) {
    ph_whole *w = of;
    for (int i = 0; i < w->sizes.nu; i++)
        if (!isfinite(u[i]))
            return PH_VALUE;
    if (w->sizes.nu == 0 || memcmp(w->free, u, sizeof(double) * ((size_t)w->sizes.nu)) == 0)
        return PH_OK;
    ph_copy(w->free, u, w->sizes.nu);
    ph_whole_changed(w);
    return PH_OK;
}

/* Energies of the last internal step at the junctions, added to the sums. */
static void book(ph_whole *w) {
    const ph_network *n = w->about;
    double *step = w->joined + w->master.ncolumn + w->sizes.nu, *total = step + n->njunction;
    double *gross = total + n->njunction;
    for (int j = 0; j < n->njunction; j++) {
        double made = 0.0;
        for (int e = n->junction[j]; e < n->junction[j + 1]; e++)
            made += w->row[PH_ROW_PAIRS][n->pair[e]];
        step[j] = made;
        total[j] += made;
        *gross += fabs(made);
    }
}

/* Means of the last internal step. */
static void average(ph_whole *w) {
    double *to = w->joined + w->master.ncolumn;
    ph_copy(w->joined, w->mean, w->master.ncolumn);
    ph_clear(to, w->sizes.nu);
    for (int i = 0; i < w->about->nmember; i++) {
        const ph_share *s = &w->shares[i];
        for (int k = 0; k < s->k; k++)
            for (int j = 0; j < w->members[i].sizes.nu; j++)
                to[w->members[i].u + j] += s->weights[k] * s->u[k * s->nu + j];
    }
}

/* Signals as their sources tell them now, where the next step starts from. */
static int follow_signals(ph_whole *w) {
    const ph_master *m = &w->master;
    for (int i = 0; i < m->nwire; i++) {
        const ph_share *from = &w->shares[m->wire_source[i]];
        const int status = from->kind->refresh(from);
        if (status)
            return status;
        w->mean[w->about->signals + i] = m->factor[i] * from->end[m->wire_output[i]];
    }
    return PH_OK;
}

/* State events inside the step that members have taken; what they set. */
static void book_events(ph_whole *w) {
    int any = 0;
    for (int i = 0; i < w->about->nmember; i++) {
        const ph_whole_member *m = &w->members[i];
        const ph_happened *own = m->inside ? w->about->members[i].inside->happened(m->inside) : NULL;
        if (!own || !own->count)
            continue;
        any = 1;
        w->happened.last = w->happened.count ? fmax(w->happened.last, own->last) : own->last;
        w->happened.count += own->count;
        for (int c = 0; c < m->sizes.ncomp; c++) {
            w->happened.energy[m->comp + c] += own->energy[c];
            w->happened.lost[m->comp + c] += own->lost[c];
        }
    }
    if (any)
        ph_whole_gather_parameters(w);
}

/* One internal step. */
int ph_whole_step(ph_whole *w, double t, double h, int number) {
    ph_master *m = &w->master;
    const int next = fabs(h - *w->h) <= SAME * fabs(h);
    if (!next && *w->h != 0.0 && m->solver->further) {
        m->solver->further(m, h / *w->h);
    } else if (!next) {
        const int status = follow_signals(w);
        if (status)
            return ph_whole_refused(w, status, t, h);
        ph_master_spread(m, w->mean);
    }
    if (!w->sampled) {
        const int status = sample(w);
        if (status)
            return ph_whole_refused(w, status, t, h);
    }
    if (ph_master_run(m, t, h, 1, number, next) != 1)
        return ph_whole_refused(w, m->refused, t + number * h, h);
    for (int i = 0; i < w->about->nmember; i++) {
        const ph_embedded *unit = w->about->members[i].unit;
        m->status[i] = unit && unit->finish ? unit->finish(w->members[i].of) : PH_OK;
        if (m->status[i])
            return ph_whole_refused(w, m->status[i], t + number * h, h);
    }
    ph_copy(w->mean, m->xi, m->ncolumn);
    *w->h = h;
    if (w->held.n)
        ph_whole_gather_parameters(w);
    book_events(w);
    average(w);
    ph_whole_gather(w);
    book(w);
    return PH_OK;
}

static int step_parts(void *of, double t, double h, int n) {
    ph_whole *w = of;
    w->happened.count = 0;
    ph_clear(w->happened.energy, 2 * w->sizes.ncomp);
    if (w->lander)
        return w->about->lander->land(w->lander, t, h, n);
    if (n > 1 && ph_whole_returns(w->about)) {
        const int status = ph_whole_save(w, w->before);
        if (status)
            return ph_whole_refused(w, status, t, h);
    }
    for (int i = 0; i < n; i++) {
        const int status = ph_whole_step(w, t, h / n, i);
        if (status && n > 1 && ph_whole_returns(w->about))
            ph_whole_load(w, w->before);
        if (status) {
            w->report.solved = i;
            return status;
        }
        if (i > 0)
            ph_whole_join(w, w->kept, i / (i + 1.0));
        if (i + 1 < n)
            ph_whole_keep(w, w->kept);
    }
    return PH_OK;
}

static int skip(void *of, double t) {
    ph_whole *w = of;
    int status = PH_OK;
    for (int i = 0; i < w->about->nmember && status == PH_OK; i++)
        status = w->members[i].map->skip(w->members[i].of, t);
    ph_whole_gather(w);
    return status;
}

static const double *signals(const void *of) {
    return ((const ph_whole *)of)->table;
}

static const double *ledger(const void *of, int row) {
    return ((const ph_whole *)of)->row[row];
}

static const double *parameters(const void *of) {
    return ((const ph_whole *)of)->p;
}

static const double *input(const void *of) {
    return ((const ph_whole *)of)->free;
}

static const double *node_outputs(const void *of) {
    const ph_whole *w = of;
    return w->table + w->offset[PH_Y_STEP];
}

static const long long *counts(const void *of) {
    const ph_whole *w = of;
    memset(w->count, 0, PH_NCOUNT * sizeof(long long));
    for (int i = 0; i < w->about->nmember; i++)
        for (int c = 0; c < PH_NCOUNT; c++)
            w->count[c] += w->members[i].map->counts(w->members[i].of)[c];
    return w->count;
}

static const ph_report *report(const void *of) {
    return &((const ph_whole *)of)->report;
}

static int part(const void *of) {
    return ((const ph_whole *)of)->part;
}

static const double *joined(const void *of) {
    return ((const ph_whole *)of)->joined;
}

/* The whole has no derivatives. */
static int sensitivity(void *of, double *s) {
    (void)of;
    (void)s;
    return PH_NO_SENSITIVITY;
}

const ph_step_map *ph_map_network(void) {
    static const ph_step_map network = {
        .sizes = ph_whole_sizes,
        .size = size,
        .init = init,
        .open = open,
        .release = ph_whole_release,
        .reset = reset,
        .initialise = initialise,
        .refresh = refresh,
        .set_x = set_x,
        .set_parameters = set_parameters,
        .set_input = set_input,
        .set_node_inputs = set_input,
        .step_parts = step_parts,
        .skip = skip,
        .signals = signals,
        .ledger = ledger,
        .parameters = parameters,
        .input = input,
        .node_outputs = node_outputs,
        .counts = counts,
        .report = report,
        .part = part,
        .sensitivity = sensitivity,
        .sensitivity_end = sensitivity,
        .kept_size = ph_whole_kept_size,
        .keep = ph_whole_keep,
        .join = ph_whole_join,
        .state_size = ph_whole_state_size,
        .save = ph_whole_save,
        .load = ph_whole_load,
        .state_fault = ph_whole_state_fault,
        .returns = ph_whole_returns,
        .forget = ph_whole_forget,
        .held_size = ph_whole_held_size,
        .write_held = ph_whole_write_held,
        .read_held = ph_whole_read_held,
        .joined = joined,
    };
    return &network;
}
