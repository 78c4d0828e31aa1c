/* Changes of modes at events. */
#include <math.h>
#include <string.h>

#include "work.h"

static size_t lay_out(ph_modes *m, const ph_switches *sw, char *base) {
    const int n = sw->n, nx = sw->nx, na = sw->na, all = nx + na;
    ph_pool part = {base, 0};
    ph_take(&part, sizeof(*m));
    m->want = ph_take(&part, (size_t)n);
    m->fixed = ph_take(&part, (size_t)n);
    m->tried = ph_take(&part, (size_t)n);
    m->which = ph_take(&part, (size_t)n);
    m->asked_of = ph_take_ints(&part, n);
    m->flip = ph_take_ints(&part, n);
    m->x = ph_take_doubles(&part, nx);
    m->a = ph_take_doubles(&part, na);
    m->u = ph_take_doubles(&part, sw->nu);
    m->p = ph_take_doubles(&part, sw->np);
    m->there = ph_take_doubles(&part, nx);
    m->then = ph_take_doubles(&part, nx);
    m->moved = ph_take_doubles(&part, sw->ncomp);
    m->left = ph_take_doubles(&part, sw->ncomp);
    m->work = ph_take_doubles(&part, ph_code_work(sw->code));
    m->xt = ph_take_doubles(&part, nx + 1);
    m->y = ph_take_doubles(&part, na + sw->nu);
    m->rates = ph_take_doubles(&part, sw->nresult);
    m->before = ph_take_doubles(&part, sw->ncomp * nx);
    m->after = ph_take_doubles(&part, sw->ncomp * nx);
    m->matrix = ph_take_doubles(&part, all * all);
    m->kept = ph_take_doubles(&part, na * na);
    m->right = ph_take_doubles(&part, all);
    m->basis = ph_take_doubles(&part, na * na);
    m->moves = ph_take_doubles(&part, na * nx);
    m->found = ph_take_doubles(&part, all);
    m->scaling = ph_take_doubles(&part, all);
    m->rows = ph_take_ints(&part, all);
    m->columns = ph_take_ints(&part, all);
    return part.used;
}

size_t ph_modes_size(const ph_switches *switches) {
    ph_modes m = {0};
    return lay_out(&m, switches, NULL);
}

ph_modes *ph_modes_init(void *memory, const ph_switches *switches, const ph_mode_source *source,
                        signed char *sides) {
    ph_modes *m = memory;
    memset(memory, 0, ph_modes_size(switches));
    m->sw = switches;
    m->source = source;
    m->started = sides;
    m->on = sides + 1;
    m->asked = m->on + switches->n;
    lay_out(m, switches, memory);
    return m;
}

void ph_modes_prepare(ph_modes *m, double h) {
    m->step = h;
}

const ph_mode_refusal *ph_modes_refusal(const ph_modes *m) {
    return &m->refusal;
}

const ph_mode *ph_modes_failed(const ph_modes *m) {
    return m->entered ? m->entered : m->present;
}

const ph_mode *ph_modes_present(ph_modes *m) {
    if (!m->present || memcmp(m->present->rows->on, m->on, (size_t)m->sw->n) != 0)
        m->present = m->source->mode(m->source->world, m->on);
    return m->present;
}

/* m->which: the switches to blame. */
static int refuse(ph_modes *m, int reason, double value, double limit) {
    m->refusal = (ph_mode_refusal){reason, m->t, value, limit, m->which};
    return PH_EVENT;
}

static int refuse_one(ph_modes *m, int j, int reason, double value, double limit) {
    memset(m->which, 0, (size_t)m->sw->n);
    m->which[j] = 1;
    return refuse(m, reason, value, limit);
}

static int any(const signed char *flags, int n) {
    int found = 0;
    for (int j = 0; j < n; j++)
        found = found || flags[j];
    return found;
}

static int refuse_all(ph_modes *m) {
    const int n = m->sw->n;
    if (any(m->fixed, n))
        memcpy(m->which, m->fixed, (size_t)n);
    else
        memset(m->which, 1, (size_t)n);
    return refuse(m, PH_REFUSED_NO_MODE, 0.0, 0.0);
}

/* Read the states, algebraic variables and inputs of the instance. */
static int read(ph_modes *m, const ph_mode *old) {
    const ph_switches *sw = m->sw;
    const int status = ph_refresh(old->in);
    const double *table = ph_signals(old->in);
    if (status)
        return status;
    memcpy(m->x, table, sizeof(double) * (size_t)sw->nx);
    memcpy(m->a, table + sw->a_end, sizeof(double) * (size_t)sw->na);
    if (sw->nu > 0)
        memcpy(m->u, ph_input(old->in), sizeof(double) * (size_t)sw->nu);
    m->t = table[sw->nx];
    return PH_OK;
}

static void set_sides(ph_modes *m, const signed char *on) {
    for (int j = 0; j < m->sw->n; j++)
        m->p[m->sw->place[j]] = on[j];
}

/* Switches that open though others, on which they depend, could leave them something to hold. */
static int dependent(ph_modes *m, const ph_mode *old) {
    const ph_switches *sw = m->sw;
    if (old->rows->nfree == 0 || !m->source->most)
        return PH_OK;
    for (int j = 0; j < sw->n; j++) {
        double most;
        if (!m->on[j] || m->want[j] || !sw->unilateral[j])
            continue;
        most = m->source->most(m->source->world, m->on, m->a, j);
        if (most > 0.0)
            return refuse_one(m, j, PH_REFUSED_SHARED, most, 0.0);
    }
    return PH_OK;
}

/* A switch that opens must not cut more than it may where states jump for it. */
static int cuts(ph_modes *m) {
    const ph_switches *sw = m->sw;
    for (int j = 0; j < sw->n; j++) {
        const double cut = fabs(m->a[sw->multiplier[j]]);
        if (m->on[j] && !m->tried[j] && cut > sw->most[j] + PH_CUT_LANDED * sw->scale[sw->multiplier[j]])
            return refuse_one(m, j, PH_REFUSED_MOST, cut, sw->most[j]);
    }
    return PH_OK;
}

/* The instance of the mode in m->tried, which goes on from the present one. */
static int enter(ph_modes *m, const ph_mode *old) {
    const ph_switches *sw = m->sw;
    const ph_mode *now = m->source->mode(m->source->world, m->tried);
    int status = PH_OK;
    if (!now)
        return refuse_all(m);
    m->entered = now;
    if (now != old) {
        status = ph_load(now->in, now->fresh);
        status = status ? status : ph_continue(now->in, old->in);
    }
    status = status ? status : ph_set_parameters(now->in, m->p);
    if (status == PH_OK && memcmp(m->then, m->x, sizeof(double) * (size_t)sw->nx) != 0)
        status = ph_set_x(now->in, m->t, m->then);
    status = status ? status : ph_initialise(now->in);
    if (status == PH_OK) {
        m->present = now;
        m->entered = NULL;
    }
    return status;
}

/* Energies of the change, booked with the first switch that changed; which did: 1 = off, 2 = on. */
static void book(ph_modes *m, double *energy, double *lost, signed char *changed) {
    const ph_switches *sw = m->sw;
    int first = -1;
    double sum = 0.0;
    for (int j = 0; j < sw->n; j++) {
        changed[j] = (signed char)(m->tried[j] == m->on[j] ? 0 : 1 + m->tried[j]);
        first = first < 0 && changed[j] ? j : first;
    }
    memcpy(m->on, m->tried, (size_t)sw->n);
    memcpy(m->asked, m->tried, (size_t)sw->n);
    *m->started = 1;
    if (first < 0)
        return;
    for (int c = 0; c < sw->ncomp; c++) {
        const double moved = m->moved[c] + m->left[c];
        energy[c] += moved;
        sum += moved;
    }
    lost[sw->owner[first]] -= sum;
}

int ph_mode_change(ph_modes *m, const double *p, const signed char *asked, double h, double *energy,
                   double *lost, signed char *changed) {
    const ph_switches *sw = m->sw;
    const ph_mode *old = ph_modes_present(m);
    int status = old ? read(m, old) : PH_EVENT, acts;
    double sum = 0.0;
    if (status)
        return status;
    m->refusal.reason = -1;
    memcpy(m->p, p, sizeof(double) * (size_t)sw->np);
    if (asked)
        set_sides(m, asked);
    for (int j = 0; j < sw->n; j++) {
        m->want[j] = (signed char)m->p[sw->place[j]];
        m->fixed[j] = m->want[j] != m->on[j];
    }
    status = dependent(m, old);
    if (status)
        return status;
    memcpy(m->there, m->x, sizeof(double) * (size_t)sw->nx);
    memset(m->left, 0, sizeof(double) * (size_t)sw->ncomp);
    if (any(m->fixed, sw->n)) { /* what the steps left of the constraints of the old mode would decide */
        set_sides(m, m->on);
        ph_mode_enter(m, m->x, m->p, m->there, m->left);
    }
    if (!ph_mode_select(m, m->there, h > 0.0 ? h : m->step))
        return refuse_all(m);
    set_sides(m, m->tried);
    acts = ph_mode_enter(m, m->there, m->p, m->then, m->moved);
    for (int c = 0; c < sw->ncomp; c++)
        sum += m->moved[c];
    if (acts && -sum > 0.0)
        status = cuts(m);
    status = status ? status : enter(m, old);
    if (status == PH_OK)
        book(m, energy, lost, changed);
    return status;
}
