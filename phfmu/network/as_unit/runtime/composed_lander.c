/* Members that land as one composed declaration: landing/composed_lander.py in C. At an instant they are one:
 * guards, modes and jumps are those of its model, which takes no step; steps are those of the network, whose
 * rows are those of the present mode. */
#include "composed_lander.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "event_landing.h"
#include "lent_network.h"
#include "relation.h"

/* The first part is what the functions of lent_network.c are given. */
typedef struct lander {
    ph_lent_network lent;
    const ph_composed *about;
    ph_mode *modes;    /* about->nmode; owned, as the instances and all below */
    ph_modes *changes; /* NULL without switches */
    ph_mode_source source;
    double *values;        /* what the work and the next five are in */
    double *energy, *lost; /* by component */
    double *signals;       /* after an event */
    double *u;             /* inputs */
    double *asked;         /* parameters, with the modes that were asked for */
    signed char *flags;    /* what the next four are in */
    signed char *sides;    /* 1+2n */
    signed char *changed;  /* n */
    signed char *fired;    /* an event each */
    signed char *stops;    /* the same: with switches all happen with their modes */
    ph_landed out;
    double t, h; /* of a step */
    double when; /* of an event */
    int before;  /* steps before it */
    size_t largest;
} lander;

static int nevent(const lander *l) {
    return l->lent.about->events->n;
}

static int nswitch(const lander *l) {
    return l->about->switches ? l->about->switches->n : 0;
}

/* -- modes ------------------------------------------------------------------------------------------------
 */

/* Place of a mode in the table, or -1. */
static int find(const lander *l, const signed char *on) {
    for (int i = 0; i < l->about->nmode; i++)
        if (memcmp(l->about->mode_rows[i].on, on, (size_t)nswitch(l)) == 0)
            return i;
    return -1;
}

static const ph_mode_rows *rows_of(void *of, const signed char *on) {
    const int i = find(of, on);
    return i < 0 ? NULL : &((const lander *)of)->about->mode_rows[i];
}

static const ph_mode *mode_of(void *of, const signed char *on) {
    const int i = find(of, on);
    return i < 0 ? NULL : &((const lander *)of)->modes[i];
}

static double most_of(void *of, const signed char *on, const double *a, int j) {
    return ph_mode_held(((const lander *)of)->about->switches, rows_of(of, on), a, j);
}

static const ph_mode *present(const lander *l) {
    return l->changes ? ph_modes_present(l->changes) : l->modes;
}

static ph_instance *take(lander *l) {
    return l->lent.in = present(l)->in;
}

/* The rows of the junctions are those of the present mode. */
static int enter(lander *l) {
    return ph_whole_enter(l->lent.w, l->about->modes[present(l) - l->modes].rows);
}

/* -- memory -----------------------------------------------------------------------------------------------
 */

void ph_composed_release(void *of) {
    lander *l = of;
    for (int i = 0; l->modes && i < l->about->nmode; i++) {
        free(l->modes[i].in);
        free((void *)(size_t)l->modes[i].fresh);
    }
    ph_lent_release(&l->lent);
    free(l->modes);
    free(l->changes);
    free(l->values);
    free(l->flags);
    free(l);
}

static int make_mode(lander *l, int i) {
    const ph_composed_mode *about = &l->about->modes[i];
    ph_mode *mode = &l->modes[i];
    const size_t size = ph_size(about->model);
    int offset[PH_NBLOCK + 1];
    size_t state;
    char *fresh;
    mode->in = size ? calloc(1, size) : NULL;
    if (!mode->in || ph_init(mode->in, about->model) != PH_OK)
        return 0;
    ph_initialise(mode->in); /* where it cannot be, entering it says so */
    state = ph_padded(ph_state_size(mode->in));
    fresh = calloc(1, state + ph_landing_size(mode->in, about->events));
    if (!fresh)
        return 0;
    mode->fresh = fresh;
    ph_save(mode->in, fresh);
    mode->landing = ph_landing_init(fresh + state, mode->in, about->events);
    ph_land_lent(mode->landing, &l->lent.steps);
    if (l->about->switches) {
        mode->rows = &l->about->mode_rows[i];
        ph_land_stops(mode->landing, l->stops);
    }
    ph_layout(about->model, offset);
    mode->length = offset[PH_NBLOCK];
    l->largest = state > l->largest ? state : l->largest;
    return 1;
}

static int step_in_mode(void *world, double t, double h) {
    take(world);
    return ph_lent_step(world, t, h);
}

static int make(lander *l) {
    const ph_plan *p = l->lent.about->model->step;
    const size_t n = (size_t)nswitch(l), events = (size_t)nevent(l);
    int most = 0;
    l->lent.steps.step = step_in_mode;
    for (int i = 0; i < l->about->nmode; i++) {
        int offset[PH_NBLOCK + 1];
        ph_layout(l->about->modes[i].model, offset);
        most = offset[PH_NBLOCK] > most ? offset[PH_NBLOCK] : most;
    }
    l->modes = calloc((size_t)l->about->nmode, sizeof(ph_mode));
    l->values = calloc((size_t)(p->nx + 2 * p->np + 2 * p->ncomp + p->nu + most) + 1, sizeof(double));
    l->flags = calloc(1 + 3 * n + 2 * events, 1);
    if (!l->modes || !l->values || !l->flags)
        return 0;
    l->lent.x = l->values;
    l->lent.p = l->lent.x + p->nx;
    l->asked = l->lent.p + p->np;
    l->energy = l->asked + p->np;
    l->lost = l->energy + p->ncomp;
    l->u = l->lost + p->ncomp;
    l->signals = l->u + p->nu;
    l->sides = l->flags;
    l->changed = l->sides + 1 + 2 * n;
    l->fired = l->changed + n;
    l->stops = l->fired + events;
    memset(l->stops, 1, events);
    for (int i = 0; i < l->about->nmode; i++)
        if (!make_mode(l, i))
            return 0;
    l->out = (ph_landed){.t = &l->t,
                         .h = &l->h,
                         .event_t = &l->when,
                         .event_step = &l->before,
                         .event_fired = l->fired,
                         .event_energy = l->energy,
                         .event_lost = l->lost,
                         .event_signals = l->signals};
    if (!l->about->switches)
        return 1;
    l->source = (ph_mode_source){l, rows_of, mode_of, most_of};
    l->changes = calloc(1, ph_modes_size(l->about->switches));
    if (!l->changes)
        return 0;
    memcpy(l->sides + 1, l->about->mode_rows[0].on, n);
    l->changes = ph_modes_init(l->changes, l->about->switches, &l->source, l->sides);
    ph_modes_prepare(l->changes, l->about->step);
    return 1;
}

void *ph_composed_make(ph_whole *w, const ph_lander *about) {
    lander *l = calloc(1, sizeof(*l));
    if (!l)
        return NULL;
    l->about = about->composed;
    if (ph_lent_make(&l->lent, w, about) && make(l))
        return l;
    ph_composed_release(l);
    return NULL;
}

int ph_composed_reset(void *of) {
    lander *l = of;
    const size_t n = (size_t)nswitch(l);
    int status;
    l->sides[0] = 0;
    if (l->about->switches) {
        memcpy(l->sides + 1, l->about->mode_rows[0].on, n);
        memcpy(l->sides + 1 + n, l->about->mode_rows[0].on, n);
    }
    ph_clear(l->modes->landing->rates, nevent(l));
    status = ph_load(take(l), l->modes->fresh);
    return status ? status : enter(l);
}

const ph_event_refusal *ph_composed_refusal(const void *of) {
    const lander *l = of;
    return ph_land_refusal((l->changes ? ph_modes_failed(l->changes) : l->modes)->landing);
}

const ph_mode_refusal *ph_composed_mode_refusal(const void *of) {
    const lander *l = of;
    const ph_mode_refusal *found = l->changes ? ph_modes_refusal(l->changes) : NULL;
    return found && found->reason >= 0 ? found : NULL;
}

/* -- what the next step goes on from besides the members: rates of the guards, sides of the switches, the
 * instance */

static size_t rates_size(const lander *l) {
    return ph_padded(sizeof(double) * (size_t)nevent(l));
}

static size_t sides_size(const lander *l) {
    return ph_padded(1 + 2 * (size_t)nswitch(l));
}

size_t ph_composed_state_size(const void *of) {
    const lander *l = of;
    return rates_size(l) + sides_size(l) + l->largest;
}

void ph_composed_save(const void *of, void *out) {
    const lander *l = of;
    char *to = out;
    ph_copy(out, present(l)->landing->rates, nevent(l));
    memcpy(to + rates_size(l), l->sides, 1 + 2 * (size_t)nswitch(l));
    ph_save(present(l)->in, to + rates_size(l) + sides_size(l));
}

int ph_composed_load(void *of, const void *from) {
    lander *l = of;
    const char *place = from;
    const signed char *sides = (const signed char *)place + rates_size(l);
    int status;
    if (l->about->switches && find(l, sides + 1) < 0)
        return PH_ARGUMENT;
    memcpy(l->sides, sides, 1 + 2 * (size_t)nswitch(l));
    ph_copy(present(l)->landing->rates, from, nevent(l));
    status = ph_load(take(l), place + rates_size(l) + sides_size(l));
    return status ? status : enter(l);
}

const char *ph_composed_fault(const void *of, const void *from) {
    const lander *l = of;
    const double *rates = from;
    const char *place = from;
    const signed char *sides = (const signed char *)place + rates_size(l);
    int mode = 0;
    for (int i = 0; i < nevent(l); i++)
        if (!isfinite(rates[i]))
            return "a rate of a guard is not finite";
    for (int i = 0; i < 1 + 2 * nswitch(l); i++)
        if (sides[i] != 0 && sides[i] != 1)
            return "a switch is neither open nor closed";
    if (l->about->switches)
        mode = find(l, sides + 1);
    if (mode < 0)
        return "it is in a mode that the unit does not have";
    return ph_state_fault(l->modes[mode].in, place + rates_size(l) + sides_size(l));
}

/* -- what the members and the composed model tell each other ----------------------------------------------
 */

static int differ(const double *a, const double *b, int n) {
    int found = 0;
    for (int i = 0; i < n; i++)
        found |= a[i] != b[i];
    return found;
}

/* Parameters as they were set: modes that were asked for are taken when it lands. */
static int ask(lander *l) {
    const ph_switches *s = l->about->switches;
    const int np = l->lent.about->model->step->np, n = nswitch(l);
    signed char *on = l->sides + 1, *asked = on + n;
    ph_copy(l->asked, ph_parameters(l->lent.in), np);
    for (int j = 0; j < n; j++)
        l->asked[s->place[j]] = asked[j];
    if (!differ(l->asked, l->lent.p, np))
        return PH_OK;
    for (int j = 0; j < n; j++) {
        asked[j] = l->lent.p[s->place[j]] != 0.0;
        l->lent.p[s->place[j]] = on[j];
    }
    return ph_set_parameters(l->lent.in, l->lent.p);
}

/* Takes what was set at the members, at t. */
static int gather(lander *l, double t) {
    const ph_plan *p = l->lent.about->model->step;
    ph_instance *in = take(l);
    int status = PH_OK;
    for (int i = 0; i < p->nu; i++)
        l->u[i] = l->lent.w->free[l->about->free[i]];
    if (p->nu)
        status = ph_set_input(in, l->u);
    ph_lent_gather(&l->lent);
    status = status ? status : ask(l);
    if (status == PH_OK && (differ(ph_signals(in), l->lent.x, p->nx) || ph_signals(in)[p->nx] != t)) {
        status = ph_set_x(in, t, l->lent.x);
        l->sides[0] = 0;
    }
    return status;
}

/* Unknowns of relations, where the next step does not go on from the last one. */
static void start_relations(const lander *l) {
    const ph_whole *w = l->lent.w;
    for (int i = 0; i < l->about->nrelation; i++) {
        const ph_whole_member *m = &w->members[l->about->relations[i]];
        ph_copy(w->mean + l->about->unknown[i], ph_relation_unknowns(m->of), m->sizes.na);
    }
}

/* All members have their inputs, and relations their values, at the present time, to which common variables
 * are `xi`. */
static int tell(lander *l, double *xi) {
    ph_whole *w = l->lent.w;
    ph_instance *in = take(l);
    const double *table = ph_signals(in), *a;
    int offset[PH_NBLOCK + 1], status = ph_refresh(in);
    ph_layout(l->lent.about->model, offset);
    a = table + offset[PH_A_END];
    for (int c = 0; c < w->master.ncolumn; c++)
        xi[c] = a[l->about->column[c]];
    status = status ? status : ph_whole_present(w, xi);
    for (int i = 0; i < l->about->nrelation; i++)
        ph_relation_tell(w->members[l->about->relations[i]].of, table[offset[PH_TIME]], a,
                         table + offset[PH_OBSERVABLES]);
    for (int i = 0; i < w->about->nmember && status == PH_OK; i++)
        status = w->members[i].map->refresh(w->members[i].of);
    return status;
}

static int begin_members(lander *l) {
    int status = PH_OK;
    for (int i = 0; i < l->lent.about->n && status == PH_OK; i++) {
        const ph_whole_member *m = ph_lent_member(&l->lent, i);
        status = m->map->initialise(m->of);
        ph_lent_tell(&l->lent, i);
    }
    return status;
}

int ph_composed_start(void *of, double t) {
    lander *l = of;
    int status = gather(l, t);
    l->lent.told = 0;
    status = status ? status : enter(l);
    status = status ? status : tell(l, l->lent.w->mean);
    return status ? status : begin_members(l);
}

/* -- events -----------------------------------------------------------------------------------------------
 */

/* The members take the states, parameters and modes that the composed model has after an event. */
static int follow(lander *l) {
    ph_whole *w = l->lent.w;
    ph_instance *in = take(l);
    const double *x = ph_signals(in), *p = ph_parameters(in);
    int status = PH_OK;
    for (int i = 0; i < l->lent.about->n && status == PH_OK; i++) {
        const ph_whole_member *m = ph_lent_member(&l->lent, i);
        const int moved = differ(m->map->signals(m->of), x, m->sizes.nx);
        if (differ(m->map->parameters(m->of), p, m->sizes.np))
            status = m->map->set_parameters(m->of, p);
        if (status == PH_OK && moved)
            status = m->map->set_x(m->of, l->when, x);
        x += m->sizes.nx;
        p += m->sizes.np;
    }
    status = status ? status : enter(l);
    status = status ? status : tell(l, w->mean);
    status = status ? status : begin_members(l);
    ph_lent_book(&l->lent, l->when, l->energy, l->lost);
    *w->h = 0.0; /* what comes is not the continuation of the step before */
    ph_master_forget(&w->master);
    ph_whole_gather_parameters(w);
    ph_whole_gather(w);
    return status;
}

/* On to an event, or to the end of a step: as much as there is room for. */
static int go_on(lander *l, int steps, int events) {
    const ph_record nothing = {.parts = 1};
    int status;
    l->out.steps_room = steps;
    l->out.events_room = events;
    l->lent.refused = PH_OK;
    status = l->changes ? ph_modes_land(l->changes, &nothing, &l->out, l->changed)
                        : ph_land(l->modes->landing, &nothing, &l->out);
    if (status && status != l->lent.refused) { /* the composed model's, whose rows are no member's */
        l->lent.w->part = l->lent.w->about->nmember;
        l->lent.w->report = (ph_report){.status = status, .row = -1, .column = -1, .time = l->t, .h = l->h};
    }
    return status;
}

static int grid_step(ph_lent_network *lent, double t, double end) {
    lander *l = (lander *)(void *)lent;
    ph_whole *w = lent->w;
    int status = PH_OK;
    if (w->set) {
        status = gather(l, t);
        start_relations(l);
    } else if (ph_signals(take(l))[lent->about->model->step->nx] != t) {
        status = ph_skip(lent->in, t);
    }
    if (l->changes)
        ph_modes_to(l->changes, t, end, w->set);
    else
        ph_land_to(l->modes->landing, t, end, w->set);
    w->set = 0;
    l->out.done = 0;
    while (status == PH_OK && !l->out.done) {
        status = go_on(l, 0, 1);
        if (status == PH_OK && l->out.events) {
            l->out.done = 0;
            status = follow(l);
            continue;
        }
        if (status || l->out.done)
            break;
        status = go_on(l, 1, 0);
        if (status == PH_OK && l->out.steps) {
            status = tell(l, w->begin);
            ph_whole_gather(w);
            ph_lent_join(lent, l->t, l->t + l->h);
        }
    }
    return status;
}

int ph_composed_land(void *of, double t, double h, int n) {
    return ph_lent_land(of, t, h, n, grid_step);
}
