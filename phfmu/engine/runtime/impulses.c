/* Impulses at the ports of an instance. */
#include <math.h>
#include <string.h>

#include "impulses.h"
#include "system.h"

struct ph_impulses {
    ph_instance *in;
    const ph_ports *ports;
    double *value; /* 4 n: at start and end of the coming steps, and of the last one */
    double *none;  /* nx or n zeros */
    double *shift; /* nstate */
    double *mean;  /* n */
    double *work;  /* n: through the ports in this step */
    double *w;
    int *iw;
    const double **arg;
    double **res;
    void *backup; /* state of the instance */
};

static size_t lay_out(ph_impulses *m, char *base) {
    const ph_ports *p = m->ports;
    const ph_function *functions[] = {p->shift, p->jump, p->tangent, p->slopes};
    ph_function most = {0};
    const size_t pointer = sizeof(double *);
    ph_pool part = {base, 0};
    for (int i = 0; i < (p->slopes ? 4 : 3); i++) {
        most.arg = functions[i]->arg > most.arg ? functions[i]->arg : most.arg;
        most.res = functions[i]->res > most.res ? functions[i]->res : most.res;
        most.iw = functions[i]->iw > most.iw ? functions[i]->iw : most.iw;
        most.w = functions[i]->w > most.w ? functions[i]->w : most.w;
    }
    ph_take(&part, sizeof(*m));
    m->value = ph_take_doubles(&part, 4 * p->n);
    m->none = ph_take_doubles(&part, p->n > m->in->step.plan->nx ? p->n : m->in->step.plan->nx);
    m->shift = ph_take_doubles(&part, p->nstate);
    m->mean = ph_take_doubles(&part, p->n);
    m->work = ph_take_doubles(&part, p->n);
    m->w = ph_take_doubles(&part, most.w);
    m->iw = ph_take_ints(&part, most.iw);
    m->arg = ph_take(&part, pointer * (size_t)most.arg);
    m->res = ph_take(&part, pointer * (size_t)most.res);
    m->backup = ph_take(&part, ph_state_size(m->in));
    return part.used;
}

size_t ph_impulses_size(const ph_instance *in, const ph_ports *ports) {
    ph_impulses m = {.in = (ph_instance *)in, .ports = ports};
    return lay_out(&m, NULL);
}

ph_impulses *ph_impulses_init(void *memory, ph_instance *in, const ph_ports *ports) {
    ph_impulses *m = memory;
    memset(memory, 0, ph_impulses_size(in, ports));
    m->in = in;
    m->ports = ports;
    lay_out(m, memory);
    return m;
}

int ph_set_impulses(ph_impulses *m, const double *s) {
    const int n = 2 * m->ports->n;
    if (!ph_finite(s, n))
        return PH_VALUE;
    memcpy(m->value, s, sizeof(double) * (size_t)n);
    return PH_OK;
}

double *ph_impulse_values(ph_impulses *m) {
    return m->value;
}

static void call(ph_impulses *m, const ph_function *f, const double *s) {
    m->arg[0] = m->in->table;
    m->arg[1] = m->in->p;
    m->arg[2] = s;
    f->call(f, m->arg, m->res, m->iw, m->w, 0);
}

void ph_jump(ph_impulses *m, double *s) {
    m->res[0] = s;
    call(m, m->ports->jump, NULL);
}

/* One impulse on the state, through its compensated sum; its work is added up. */
static int kick(ph_impulses *m, const double *s) {
    const ph_ports *p = m->ports;
    m->res[0] = m->shift;
    m->res[1] = m->mean;
    call(m, p->shift, s);
    for (int j = 0; j < p->n; j++)
        m->work[j] += s[j] * m->mean[j];
    if (!ph_finite(m->shift, p->nstate) || !ph_finite(m->work, p->n)) {
        m->in->report = (ph_report){.status = PH_NOT_FINITE, .row = -1, .column = -1};
        m->in->report.time = m->in->table[m->in->step.plan->nx];
        return PH_NOT_FINITE;
    }
    for (int i = 0; i < p->nstate; i++)
        ph_add(&m->in->table[p->state[i]], &m->in->rest[p->state[i]], m->shift[i]);
    m->in->head->dirty = 1;
    return PH_OK;
}

/* The work in the ledger of the step and in the cumulative sums; stored is what was supplied. */
static void book(ph_impulses *m) {
    ph_instance *in = m->in;
    const ph_plan *plan = in->step.plan;
    double *energy = in->table + in->offset[PH_ENERGY], *supplied = in->table + in->offset[PH_SUPPLIED];
    for (int j = 0; j < m->ports->n; j++) {
        const int pair = m->ports->pair[j], owner = plan->pair_owner[pair];
        in->row[PH_ROW_STORED][owner] += m->work[j];
        in->row[PH_ROW_SUPPLIED][owner] += m->work[j];
        in->row[PH_ROW_MOVED][owner] += fabs(m->work[j]);
        in->row[PH_ROW_PAIRS][pair] += m->work[j];
        ph_add(&energy[pair], &in->table_rest[pair], m->work[j]);
        ph_add(&supplied[owner], &in->table_rest[plan->nq + 3 * owner], m->work[j]);
    }
}

static int any(const double *values, int n) {
    int found = 0;
    for (int i = 0; i < n; i++)
        found |= values[i] != 0.0;
    return found;
}

int ph_kick(ph_impulses *m, double t) {
    const int size = m->ports->n;
    int status;
    ph_save(m->in, m->backup);
    ph_clear(m->work, size);
    status = ph_skip(m->in, t);
    for (int end = 0; status == PH_OK && end < 2; end++)
        status = kick(m, m->value + end * size);
    if (status) {
        ph_load(m->in, m->backup);
        return status;
    }
    memcpy(m->value + 2 * size, m->value, sizeof(double) * 2 * (size_t)size);
    book(m);
    return PH_OK;
}

int ph_kick_more(ph_impulses *m, const double *s) {
    const int size = m->ports->n;
    double *old = m->value + 3 * size;
    int status;
    ph_save(m->in, m->backup);
    ph_clear(m->work, size);
    status = kick(m, s);
    if (status) {
        ph_load(m->in, m->backup);
        return status;
    }
    for (int j = 0; j < size; j++)
        old[j] += s[j];
    book(m);
    return PH_OK;
}

int ph_step_impulses(ph_impulses *m, double t, double h, int n) {
    const int size = m->ports->n;
    double *now = m->value, *old = m->value + 2 * size;
    int status;
    if (h == 0.0 || ph_is_sliver(m->in, t, h))
        return ph_step_parts(m->in, t, h, n);
    if (!any(now, 2 * size)) {
        status = ph_step_parts(m->in, t, h, n);
        if (status == PH_OK)
            ph_clear(old, 2 * size);
        return status;
    }
    ph_save(m->in, m->backup);
    ph_clear(m->work, size);
    status = any(now, size) ? kick(m, now) : PH_OK;
    if (status == PH_OK)
        status = ph_step_parts(m->in, t, h, n);
    if (status == PH_OK && any(now + size, size)) {
        status = kick(m, now + size);
        m->in->count[PH_STEPS] -= status != PH_OK;
        m->in->count[PH_FAILED] += status != PH_OK;
    }
    if (status) {
        ph_load(m->in, m->backup);
        return status;
    }
    memcpy(old, now, sizeof(double) * 2 * (size_t)size);
    book(m);
    return PH_OK;
}

/* L does not change along its own shifts: it is the same before and after an impulse. */
void ph_impulses_along(ph_impulses *m, int end, int count, const double *ds, double *dx) {
    const ph_instance *in = m->in;
    const ph_ports *p = m->ports;
    const int width = in->step.plan->nx + 1 + in->step.plan->na;
    for (int j = 0; j < count; j++) {
        m->arg[0] = end ? in->table : in->x_old;
        m->arg[1] = in->p;
        m->arg[2] = m->value + (end ? 3 : 2) * p->n;
        m->arg[3] = dx + j * width;
        m->arg[4] = ds + j * p->n;
        m->res[0] = m->shift;
        p->tangent->call(p->tangent, m->arg, m->res, m->iw, m->w, 0);
        for (int i = 0; i < p->nstate; i++)
            dx[j * width + p->state[i]] += m->shift[i];
    }
}

void ph_impulses_by(ph_impulses *m, int end, const double *dp, double *dx) {
    const ph_instance *in = m->in;
    const ph_ports *p = m->ports;
    m->arg[0] = end ? in->table : in->x_old;
    m->arg[1] = in->p;
    m->arg[2] = m->value + (end ? 3 : 2) * p->n;
    m->arg[3] = m->none;
    m->arg[4] = dp;
    m->res[0] = m->shift;
    m->res[1] = NULL;
    p->slopes->call(p->slopes, m->arg, m->res, m->iw, m->w, 0);
    for (int i = 0; i < p->nstate; i++)
        dx[p->state[i]] += m->shift[i];
}

void ph_jump_along(ph_impulses *m, const double *dx, const double *dp, double *dS) {
    const ph_ports *p = m->ports;
    m->arg[0] = m->in->table;
    m->arg[1] = m->in->p;
    m->arg[2] = m->none;
    m->arg[3] = dx;
    m->arg[4] = dp;
    m->res[0] = NULL;
    m->res[1] = dS;
    p->slopes->call(p->slopes, m->arg, m->res, m->iw, m->w, 0);
}
