/* The blocks of coupled members side by side, what is kept and saved of them: their states, and what the
 * coupling goes on from. */
#include <math.h>

#include "network_whole.h"
#include "system.h"

int ph_whole_njoined(const ph_network *n, int nu) {
    return n->master.ncolumn + nu + 2 * n->njunction + 1;
}

const ph_step_map *ph_whole_map(const ph_network_member *m, const void **about) {
    *about = m->unit ? m->unit->about : m->model;
    return m->unit ? m->unit->map() : ph_map_model();
}

void ph_whole_sizes(const void *about, ph_sizes *s) {
    const ph_network *n = about;
    static const double one = 1.0;
    *s = (ph_sizes){.k = 1, .weights = &one};
    for (int i = 0; i < n->nmember; i++) {
        ph_sizes own;
        const void *of;
        const ph_step_map *map = ph_whole_map(&n->members[i], &of);
        map->sizes(of, &own);
        s->nx += own.nx;
        s->na += own.na;
        s->nu += own.nu;
        s->nq += own.nq;
        s->np += own.np;
        s->nobs += own.nobs;
        s->ncomp += own.ncomp;
    }
}

void ph_whole_gather(ph_whole *w) {
    for (int i = 0; i < w->about->nmember; i++) {
        const ph_whole_member *m = &w->members[i];
        const double *table = m->map->signals(m->of);
        for (int b = 0; b < PH_NBLOCK; b++)
            if (b != PH_TIME || i == 0)
                ph_copy(w->table + m->first[b], table + m->offset[b], m->offset[b + 1] - m->offset[b]);
        for (int r = 0; r < PH_NROW; r++)
            ph_copy(w->row[r] + (r == PH_ROW_PAIRS ? m->pairs : m->comp), m->map->ledger(m->of, r),
                    r == PH_ROW_PAIRS ? m->sizes.nq : m->sizes.ncomp);
    }
}

void ph_whole_gather_parameters(ph_whole *w) {
    for (int i = 0; i < w->about->nmember; i++)
        ph_copy(w->p + w->members[i].p, w->members[i].map->parameters(w->members[i].of),
                w->members[i].sizes.np);
}

int ph_whole_kept_size(const void *about) {
    const ph_network *n = about;
    ph_sizes s;
    int size;
    ph_whole_sizes(n, &s);
    size = n->master.ncolumn + s.nu + n->njunction;
    for (int i = 0; i < n->nmember; i++) {
        const void *of;
        const ph_step_map *map = ph_whole_map(&n->members[i], &of);
        size += map->kept_size(of);
    }
    return size;
}

void ph_whole_keep(const void *of, double *kept) {
    const ph_whole *w = of;
    const int means = w->master.ncolumn + w->sizes.nu + w->about->njunction;
    ph_copy(kept, w->joined, means);
    kept += means;
    for (int i = 0; i < w->about->nmember; i++) {
        const ph_whole_member *m = &w->members[i];
        m->map->keep(m->of, kept);
        kept += m->map->kept_size(m->about);
    }
}

void ph_whole_join(void *of, const double *kept, double part) {
    ph_whole *w = of;
    const int means = w->master.ncolumn + w->sizes.nu;
    for (int i = 0; i < means; i++)
        w->joined[i] = part * kept[i] + (1.0 - part) * w->joined[i];
    kept += means;
    for (int j = 0; j < w->about->njunction; j++)
        w->joined[means + j] += kept[j];
    kept += w->about->njunction;
    for (int i = 0; i < w->about->nmember; i++) {
        const ph_whole_member *m = &w->members[i];
        m->map->join(m->of, kept, part);
        kept += m->map->kept_size(m->about);
    }
    ph_whole_gather(w);
}

/* Doubles of held signals: whether they are sampled, and whether before, the length of the last step, then
 * samples now and before. */
static size_t held_values(const ph_whole *w) {
    return w->held.n ? 3 + 2 * (size_t)w->held.n : 0;
}

static double *save_held(const ph_whole *w, double *to) {
    const ph_held *s = &w->held;
    if (!s->n)
        return to;
    *to++ = w->sampled;
    *to++ = s->known;
    *to++ = s->last;
    ph_copy(to, s->now, s->n);
    ph_copy(to + s->n, s->before, s->n);
    return to + 2 * s->n;
}

static const double *load_held(ph_whole *w, const double *from) {
    ph_held *s = &w->held;
    if (!s->n)
        return from;
    w->sampled = *from++ != 0.0;
    s->known = *from++ != 0.0;
    s->last = *from++;
    ph_copy(s->now, from, s->n);
    ph_copy(s->before, from + s->n, s->n);
    return from + 2 * s->n;
}

/* Doubles of a saved state that are not in those of the members: held signals, the length of the last step,
 * free inputs, means, what is joined, and what the solver goes on from. */
static size_t own_values(const ph_whole *w) {
    return held_values(w) + 1 + (size_t)w->sizes.nu + (size_t)w->master.ncolumn +
           (size_t)ph_whole_njoined(w->about, w->sizes.nu);
}

static size_t remembered(const ph_whole *w) {
    return own_values(w) + (size_t)ph_master_remembered(&w->master);
}

size_t ph_whole_values_size(const ph_whole *w, int i) {
    return w->members[i].kicks ? 4 * sizeof(double) * (size_t)w->about->members[i].ports->n : 0;
}

/* Of the state of a member. */
static size_t member_size(const ph_whole *w, int i) {
    return ph_padded(w->members[i].map->state_size(w->members[i].of));
}

size_t ph_whole_placed_size(const ph_whole *w) {
    size_t size = sizeof(double) * remembered(w);
    for (int i = 0; i < w->about->nmember; i++)
        size += member_size(w, i) + ph_padded(ph_whole_values_size(w, i));
    return ph_padded(size);
}

/* Behind it, whether values were set, then what those who land go on from. */
static size_t landing_size(const ph_whole *w) {
    return w->lander ? ph_padded(sizeof(double)) + ph_padded(w->about->lander->state_size(w->lander)) : 0;
}

static char *landing_state(const ph_whole *w, void *state) {
    return (char *)state + ph_whole_placed_size(w);
}

size_t ph_whole_state_size(const void *of) {
    const ph_whole *w = of;
    return ph_whole_placed_size(w) + landing_size(w);
}

int ph_whole_save(void *of, void *out) {
    ph_whole *w = of;
    char *to = landing_state(w, out);
    if (w->lander) {
        const double set = w->set;
        memcpy(to, &set, sizeof(set));
        w->about->lander->save(w->lander, to + ph_padded(sizeof(double)));
    }
    return ph_whole_put(w, out);
}

int ph_whole_load(void *of, const void *from) {
    ph_whole *w = of;
    const char *place = (const char *)from + ph_whole_placed_size(w);
    int status = PH_OK, answer;
    if (w->lander) {
        double set;
        memcpy(&set, place, sizeof(set));
        w->set = set != 0.0;
        status = w->about->lander->load(w->lander, place + ph_padded(sizeof(double)));
    }
    answer = ph_whole_back(w, from);
    return answer ? answer : status;
}

int ph_whole_put(ph_whole *w, void *out) {
    const ph_master *m = &w->master;
    char *to = out;
    double *values;
    int status = PH_OK;
    for (int i = 0; i < w->about->nmember; i++) {
        const ph_whole_member *own = &w->members[i];
        const int answer = own->map->save(own->of, to);
        status = answer ? answer : status;
        to += member_size(w, i);
        if (own->kicks)
            memcpy(to, own->native.values, ph_whole_values_size(w, i));
        to += ph_padded(ph_whole_values_size(w, i));
    }
    values = save_held(w, (double *)(void *)to);
    *values++ = *w->h;
    ph_copy(values, w->free, w->sizes.nu);
    values += w->sizes.nu;
    ph_copy(values, w->mean, m->ncolumn);
    values += m->ncolumn;
    ph_copy(values, w->joined, ph_whole_njoined(w->about, w->sizes.nu));
    ph_master_save(m, values + ph_whole_njoined(w->about, w->sizes.nu));
    return status;
}

int ph_whole_back(ph_whole *w, const void *from) {
    ph_master *m = &w->master;
    const char *place = from;
    const double *values;
    int status = PH_OK;
    for (int i = 0; i < w->about->nmember && status == PH_OK; i++) {
        const ph_whole_member *own = &w->members[i];
        status = own->map->load(own->of, place);
        place += member_size(w, i);
        if (own->kicks)
            memcpy(own->native.values, place, ph_whole_values_size(w, i));
        place += ph_padded(ph_whole_values_size(w, i));
    }
    values = load_held(w, (const double *)(const void *)place);
    *w->h = *values++;
    ph_copy(w->free, values, w->sizes.nu);
    values += w->sizes.nu;
    ph_copy(w->mean, values, m->ncolumn);
    values += m->ncolumn;
    ph_copy(w->joined, values, ph_whole_njoined(w->about, w->sizes.nu));
    ph_master_spread(m, w->mean);
    ph_master_load(m, values + ph_whole_njoined(w->about, w->sizes.nu));
    w->begun = 0;
    ph_whole_gather_parameters(w);
    ph_whole_gather(w);
    return status;
}

const char *ph_whole_state_fault(const void *of, const void *from) {
    const ph_whole *w = of;
    const char *place = from;
    const double *values;
    for (int i = 0; i < w->about->nmember; i++) {
        const char *wrong = w->members[i].map->state_fault(w->members[i].of, place);
        if (wrong)
            return wrong;
        place += member_size(w, i) + ph_padded(ph_whole_values_size(w, i));
    }
    values = (const double *)(const void *)place;
    for (size_t i = 0; i < remembered(w); i++)
        if (!isfinite(values[i]))
            return "a value of the coupling is not finite";
    if (!ph_master_sound(&w->master, values + own_values(w)))
        return "a count or a size of the coupling is out of range";
    if (w->lander)
        return w->about->lander->fault(w->lander, (const char *)from + ph_whole_placed_size(w) +
                                                      ph_padded(sizeof(double)));
    return NULL;
}

int ph_whole_returns(const void *about) {
    const ph_network *n = about;
    for (int i = 0; i < n->nmember; i++) {
        const void *of;
        const ph_step_map *map = ph_whole_map(&n->members[i], &of);
        if (map->returns && !map->returns(of))
            return 0;
    }
    return 1;
}

/* The state of a member in one of all. */
static char *member_state(const ph_whole *w, int i, void *state) {
    char *place = state;
    for (int before = 0; before < i; before++)
        place += member_size(w, before) + ph_padded(ph_whole_values_size(w, before));
    return place;
}

void ph_whole_forget(void *of, void *state) {
    const ph_whole *w = of;
    for (int i = 0; i < w->about->nmember; i++) {
        const ph_whole_member *m = &w->members[i];
        if (m->map->forget)
            m->map->forget(m->of, member_state(w, i, state));
    }
}

/* Of each member that keeps something: how many bytes, then these; without room, their size alone. */
static int held(const ph_whole *w, void *state, char *bytes, size_t *n) {
    int status = PH_OK;
    *n = 0;
    for (int i = 0; i < w->about->nmember && status == PH_OK; i++) {
        const ph_whole_member *m = &w->members[i];
        size_t own = 0;
        if (!m->map->held_size)
            continue;
        status = m->map->held_size(m->of, member_state(w, i, state), &own);
        if (bytes && status == PH_OK) {
            memcpy(bytes + *n, &own, sizeof(own));
            status = m->map->write_held(m->of, member_state(w, i, state), bytes + *n + sizeof(own));
        }
        *n += sizeof(own) + own;
    }
    return status;
}

int ph_whole_held_size(void *of, void *state, size_t *n) {
    return held(of, state, NULL, n);
}

int ph_whole_write_held(void *of, void *state, char *bytes) {
    size_t n;
    return held(of, state, bytes, &n);
}

/* Where one refuses its part, nothing is kept of any. */
int ph_whole_read_held(void *of, void *state, const char *bytes, size_t n) {
    const ph_whole *w = of;
    int status = PH_OK;
    for (int i = 0; i < w->about->nmember; i++) {
        const ph_whole_member *m = &w->members[i];
        size_t own = 0;
        if (!m->map->read_held)
            continue;
        if (status == PH_OK && n < sizeof(own))
            status = PH_VALUE;
        if (status == PH_OK)
            memcpy(&own, bytes, sizeof(own));
        if (status == PH_OK && own > n - sizeof(own))
            status = PH_VALUE;
        if (status) { /* of the others nothing may be taken for something that is kept */
            m->map->read_held(m->of, member_state(w, i, state), NULL, 0);
            continue;
        }
        status = m->map->read_held(m->of, member_state(w, i, state), bytes + sizeof(own), own);
        bytes += sizeof(own) + own;
        n -= sizeof(own) + own;
    }
    if (status == PH_OK && n > 0)
        status = PH_VALUE;
    if (status)
        ph_whole_forget(of, state);
    return status;
}
