/* Members that all land on state events together: landing/coupled_lander.py in C. Guards are those of a model
 * that has the states of the members with events side by side; it takes no step, steps are those of the
 * network.
 */
#include "network_lander.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "event_landing.h"
#include "lent_network.h"

/* The first part is what the functions of lent_network.c are given. */
typedef struct lander {
    ph_lent_network lent;
    ph_landing *landing;   /* owned, as the instance and all below */
    double *values;        /* what the next two and the work of `lent` are in */
    double *energy, *lost; /* by component of the model */
    signed char *stops;    /* 1 for each event: all happen here */
    signed char *fired;
    ph_landed out;
    double t, h; /* of a step */
} lander;

static int nevent(const lander *l) {
    return l->lent.about->events->n;
}

/* -- memory -----------------------------------------------------------------------------------------------
 */

void ph_lander_release(void *of) {
    lander *l = of;
    ph_lent_release(&l->lent);
    free(l->lent.in);
    free(l->landing);
    free(l->values);
    free(l->stops);
    free(l);
}

static int made(lander *l) {
    const ph_lander *about = l->lent.about;
    const ph_plan *p = about->model->step;
    ph_instance *in = l->lent.in = calloc(1, ph_size(about->model));
    if (!in || ph_init(in, about->model) != PH_OK)
        return 0;
    l->landing = calloc(1, ph_landing_size(in, about->events));
    l->values = calloc((size_t)(p->nx + p->np + 2 * p->ncomp) + 1, sizeof(double));
    l->stops = calloc((size_t)(2 * nevent(l)), 1);
    if (!l->landing || !l->values || !l->stops)
        return 0;
    l->lent.x = l->values;
    l->lent.p = l->lent.x + p->nx;
    l->energy = l->lent.p + p->np;
    l->lost = l->energy + p->ncomp;
    l->fired = l->stops + nevent(l);
    memset(l->stops, 1, (size_t)nevent(l));
    l->landing = ph_landing_init(l->landing, in, about->events);
    l->out = (ph_landed){.steps_room = 1, .events_room = 1, .t = &l->t, .h = &l->h};
    ph_land_lent(l->landing, &l->lent.steps);
    ph_land_stops(l->landing, l->stops);
    return 1;
}

void *ph_lander_make(ph_whole *w, const ph_lander *about) {
    lander *l = calloc(1, sizeof(*l));
    if (!l)
        return NULL;
    if (ph_lent_make(&l->lent, w, about) && made(l))
        return l;
    ph_lander_release(l);
    return NULL;
}

const ph_event_refusal *ph_lander_refusal(const void *of) {
    return ph_land_refusal(((const lander *)of)->landing);
}

/* -- what the next step goes on from besides the members: rates of the guards ------------------------------
 */

size_t ph_lander_state_size(const void *of) {
    return sizeof(double) * (size_t)nevent(of);
}

void ph_lander_save(const void *of, void *out) {
    ph_copy(out, ((const lander *)of)->landing->rates, nevent(of));
}

int ph_lander_load(void *of, const void *from) {
    ph_copy(((lander *)of)->landing->rates, from, nevent(of));
    return PH_OK;
}

const char *ph_lander_fault(const void *of, const void *from) {
    const double *rates = from;
    for (int i = 0; i < nevent(of); i++)
        if (!isfinite(rates[i]))
            return "a rate of a guard is not finite";
    return NULL;
}

/* -- events -----------------------------------------------------------------------------------------------
 */

/* Member number i and its guards from `first` on: whether one happens, and whether states may jump. */
static int concerned(const lander *l, int i, int first, int *jumps) {
    const ph_events *e = l->lent.about->own[i];
    int any = 0;
    *jumps = 0;
    for (int j = 0; j < e->n; j++) {
        any |= l->fired[first + j] != 0;
        *jumps |= l->fired[first + j] && e->jump_of[j] >= 0;
    }
    *jumps |= any && e->ncolumn > e->njump;
    return any;
}

/* The members take the states and parameters of the model after the event. */
static int follow(lander *l, double t) {
    const ph_lander *about = l->lent.about;
    const double *x = ph_signals(l->lent.in), *p = ph_happen_parameters(l->landing);
    int status = PH_OK, first = 0;
    ph_copy(l->lent.p, p, about->model->step->np);
    p = l->lent.p;
    for (int i = 0; i < about->n && status == PH_OK; i++) {
        const ph_whole_member *m = ph_lent_member(&l->lent, i);
        int jumps;
        if (concerned(l, i, first, &jumps)) {
            status = jumps ? m->map->set_x(m->of, t, x) : PH_OK;
            status = status ? status : m->map->set_parameters(m->of, p);
            status = status ? status : m->map->initialise(m->of);
            ph_lent_tell(&l->lent, i);
        }
        x += m->sizes.nx;
        p += m->sizes.np;
        first += about->own[i]->n;
    }
    return status ? status : ph_set_parameters(l->lent.in, l->lent.p);
}

/* The events that the landing stopped before, at t. */
static int happen(lander *l, double t) {
    ph_whole *w = l->lent.w;
    int status = ph_happen_jump(l->landing, l->energy, l->lost);
    if (status)
        return status;
    ph_happen_flags(l->landing, l->fired);
    status = follow(l, t);
    if (status)
        return status;
    ph_lent_book(&l->lent, t, l->energy, l->lost);
    *w->h = 0.0; /* what comes is not the continuation of the step before */
    ph_master_forget(&w->master);
    status = ph_whole_present(w, w->mean);
    for (int i = 0; i < w->about->nmember && status == PH_OK; i++)
        status = w->members[i].map->refresh(w->members[i].of);
    ph_whole_gather_parameters(w);
    ph_whole_gather(w);
    return status ? status : ph_land_after(l->landing, l->landing);
}

static int grid_step(ph_lent_network *lent, double t, double end) {
    const ph_record nothing = {.parts = 1};
    lander *l = (lander *)(void *)lent;
    ph_whole *w = lent->w;
    int status = ph_lent_states(lent, t);
    ph_lent_gather(lent);
    status = status ? status : ph_set_parameters(lent->in, lent->p);
    ph_land_to(l->landing, t, end, w->set);
    w->set = 0;
    l->out.done = 0;
    while (status == PH_OK && !l->out.done) {
        double now;
        int count;
        status = ph_land(l->landing, &nothing, &l->out);
        if (status == PH_OK && l->out.steps)
            ph_lent_join(lent, l->t, l->landing->t);
        if (status == PH_OK && ph_land_stopped(l->landing, &now, &count))
            status = happen(l, now);
    }
    return status;
}

int ph_lander_land(void *of, double t, double h, int n) {
    return ph_lent_land(of, t, h, n, grid_step);
}
