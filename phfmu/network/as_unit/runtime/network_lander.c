/* Members that all land on state events together: landing/coupled_lander.py in C. Guards are those of a model
 * that has the states of the members with events side by side; it takes no step, steps are those of the
 * network.
 */
#include "network_lander.h"

#include <stdlib.h>
#include <string.h>

#include "event_landing.h"
#include "network_whole.h"

typedef struct lander {
    const ph_lander *about;
    ph_whole *w;
    ph_instance *in; /* owned, as all below */
    ph_landing *landing;
    char *before; /* where the network was when a trial began */
    double *values;
    double *x, *p;         /* of the model: work, in values as those below */
    double *energy, *lost; /* by component of the model */
    signed char *stops;    /* 1 for each event: all happen here */
    signed char *fired;
    ph_lent_steps lent;
    ph_landed out;
    double t, h;
    double begun; /* of the communication step */
    int told;     /* 1: a step of it was taken */
} lander;

/* Of the members with events, in their order, the number i-th. */
static const ph_whole_member *member(const lander *l, int i) {
    return &l->w->members[l->about->members[i]];
}

/* The model has the states of the members at t. */
static int take_states(lander *l, double t) {
    double *to = l->x;
    for (int i = 0; i < l->about->n; i++) {
        const ph_whole_member *m = member(l, i);
        ph_copy(to, m->map->signals(m->of), m->sizes.nx);
        to += m->sizes.nx;
    }
    return ph_set_x(l->in, t, l->x);
}

static int take_parameters(lander *l) {
    double *to = l->p;
    for (int i = 0; i < l->about->n; i++) {
        const ph_whole_member *m = member(l, i);
        ph_copy(to, m->map->parameters(m->of), m->sizes.np);
        to += m->sizes.np;
    }
    return ph_set_parameters(l->in, l->p);
}

/* -- steps of the network, lent to the model --------------------------------------------------------------
 */

static int lent_step(void *world, double t, double h) {
    lander *l = world;
    const int status = ph_whole_step(l->w, t, h, 0);
    return status ? status : take_states(l, t + h);
}

static long long lent_halved(void *world) {
    const lander *l = world;
    long long n = 0;
    for (int i = 0; i < l->about->n; i++)
        n += member(l, i)->in->count[PH_SUBSTEPS];
    return n;
}

static void lent_inside(void *world, double tau, double *x) {
    const lander *l = world;
    for (int i = 0; i < l->about->n; i++) {
        const ph_whole_member *m = member(l, i);
        const ph_events *e = l->about->own[i];
        int at = 0;
        while (at + 1 < e->npoint && e->fit_tau[at] != tau)
            at++;
        ph_events_inside(e, m->in->model->step->k, at, m->in->step.last, x);
        x += m->sizes.nx;
    }
}

static void lent_save(void *world) {
    const lander *l = world;
    ph_whole_put(l->w, l->before);
}

static void lent_load(void *world) {
    const lander *l = world;
    ph_whole_back(l->w, l->before);
}

/* -- memory -----------------------------------------------------------------------------------------------
 */

void ph_lander_release(void *of) {
    lander *l = of;
    free(l->in);
    free(l->landing);
    free(l->before);
    free(l->values);
    free(l->stops);
    free(l);
}

static int made(lander *l) {
    const ph_plan *p = l->about->model->step;
    const int n = l->about->events->n;
    l->in = calloc(1, ph_size(l->about->model));
    if (!l->in || ph_init(l->in, l->about->model) != PH_OK)
        return 0;
    l->landing = calloc(1, ph_landing_size(l->in, l->about->events));
    l->before = calloc(1, ph_whole_placed_size(l->w));
    l->values = calloc((size_t)(p->nx + p->np + 2 * p->ncomp) + 1, sizeof(double));
    l->stops = calloc((size_t)(2 * n), 1);
    if (!l->landing || !l->before || !l->values || !l->stops)
        return 0;
    l->x = l->values;
    l->p = l->x + p->nx;
    l->energy = l->p + p->np;
    l->lost = l->energy + p->ncomp;
    l->fired = l->stops + n;
    memset(l->stops, 1, (size_t)n);
    l->landing = ph_landing_init(l->landing, l->in, l->about->events);
    l->lent = (ph_lent_steps){l, lent_step, lent_halved, lent_inside, lent_save, lent_load};
    l->out = (ph_landed){.steps_room = 1, .events_room = 1, .t = &l->t, .h = &l->h};
    ph_land_lent(l->landing, &l->lent);
    ph_land_stops(l->landing, l->stops);
    return 1;
}

void *ph_lander_make(ph_whole *w, const ph_lander *about) {
    lander *l = calloc(1, sizeof(*l));
    if (!l)
        return NULL;
    l->about = about;
    l->w = w;
    if (made(l))
        return l;
    ph_lander_release(l);
    return NULL;
}

double *ph_lander_rates(const void *of) {
    return ph_land_rates(((const lander *)of)->landing);
}

const ph_event_refusal *ph_lander_refusal(const void *of) {
    return ph_land_refusal(((const lander *)of)->landing);
}

/* -- events -----------------------------------------------------------------------------------------------
 */

/* Member number i and its guards from `first` on: whether one happens, and whether states may jump. */
static int concerned(const lander *l, int i, int first, int *jumps) {
    const ph_events *e = l->about->own[i];
    int any = 0;
    *jumps = 0;
    for (int j = 0; j < e->n; j++) {
        any |= l->fired[first + j] != 0;
        *jumps |= l->fired[first + j] && e->jump_of[j] >= 0;
    }
    *jumps |= any && e->ncolumn > e->njump;
    return any;
}

/* Means and energies of member number i are those of the communication step again. */
static void tell(const lander *l, int i) {
    const ph_whole *w = l->w;
    const int own = l->about->members[i];
    const double *kept = w->kept + w->master.ncolumn + w->sizes.nu + w->about->njunction;
    for (int j = 0; j < own; j++)
        kept += w->members[j].map->kept_size(w->members[j].about);
    if (!l->told)
        return;
    ph_clear_ledger(w->members[own].in);
    w->members[own].map->join(w->members[own].of, kept, 1.0);
}

/* The members take the states and parameters of the model after the event. */
static int follow(lander *l, double t) {
    const double *x = ph_signals(l->in), *p = ph_happen_parameters(l->landing);
    int status = PH_OK, first = 0;
    memcpy(l->p, p, sizeof(double) * (size_t)l->about->model->step->np);
    p = l->p;
    for (int i = 0; i < l->about->n && status == PH_OK; i++) {
        const ph_whole_member *m = member(l, i);
        int jumps;
        if (concerned(l, i, first, &jumps)) {
            status = jumps ? m->map->set_x(m->of, t, x) : PH_OK;
            status = status ? status : m->map->set_parameters(m->of, p);
            status = status ? status : m->map->initialise(m->of);
            tell(l, i);
        }
        x += m->sizes.nx;
        p += m->sizes.np;
        first += l->about->own[i]->n;
    }
    return status ? status : ph_set_parameters(l->in, l->p);
}

/* What the event made of stored energy, and lost. */
static void book(const lander *l, double t) {
    ph_happened *to = &l->w->happened;
    const double *energy = l->energy, *lost = l->lost;
    to->count++;
    to->last = t;
    for (int i = 0; i < l->about->n; i++) {
        const ph_whole_member *m = member(l, i);
        for (int c = 0; c < m->sizes.ncomp; c++) {
            to->energy[m->comp + c] += *energy++;
            to->lost[m->comp + c] += *lost++;
        }
    }
}

/* The events that the landing stopped before, at t. */
static int happen(lander *l, double t) {
    ph_whole *w = l->w;
    int status = ph_happen_jump(l->landing, l->energy, l->lost);
    if (status)
        return status;
    ph_happen_flags(l->landing, l->fired);
    status = follow(l, t);
    if (status)
        return status;
    book(l, t);
    *w->h = 0.0; /* what comes is not the continuation of the step before */
    ph_master_forget(&w->master);
    status = ph_whole_present(w, w->mean);
    for (int i = 0; i < w->about->nmember && status == PH_OK; i++)
        status = w->members[i].map->refresh(w->members[i].of);
    ph_whole_gather_parameters(w);
    ph_whole_gather(w);
    return status ? status : ph_land_after(l->landing, l->landing);
}

/* The step that was taken, and those of the communication step before it, together. */
static void join(lander *l) {
    ph_whole *w = l->w;
    if (l->told)
        ph_whole_join(w, w->kept, (l->t - l->begun) / (l->landing->t - l->begun));
    ph_whole_keep(w, w->kept);
    l->told = 1;
}

static int grid_step(lander *l, double t, double end) {
    const ph_record nothing = {.parts = 1};
    int status = take_states(l, t);
    status = status ? status : take_parameters(l);
    ph_land_to(l->landing, t, end, l->w->set);
    l->w->set = 0;
    l->out.done = 0;
    while (status == PH_OK && !l->out.done) {
        double now;
        int count;
        status = ph_land(l->landing, &nothing, &l->out);
        if (status == PH_OK && l->out.steps)
            join(l);
        if (status == PH_OK && ph_land_stopped(l->landing, &now, &count))
            status = happen(l, now);
    }
    return status;
}

int ph_lander_land(void *of, double t, double h, int n) {
    lander *l = of;
    ph_whole *w = l->w;
    int status = ph_whole_save(w, w->before);
    l->begun = t;
    l->told = 0;
    for (int i = 0; i < n && status == PH_OK; i++)
        status = grid_step(l, t + i * (h / n), i + 1 < n ? t + (i + 1) * (h / n) : t + h);
    if (status == PH_OK)
        return PH_OK;
    if (status == PH_EVENT)
        w->part = w->about->nmember;
    ph_whole_load(w, w->before);
    w->report.solved = 0;
    return status;
}
