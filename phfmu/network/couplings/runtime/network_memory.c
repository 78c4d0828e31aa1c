/* The memory of coupled members: instances, the master with what it works on, and tables of the whole. */
#include <stdlib.h>

#include "network_whole.h"
#include "system.h"

static size_t doubles(size_t n) {
    return sizeof(double) * n;
}

static int make_member(ph_whole *w, int i) {
    const ph_network_member *about = &w->about->members[i];
    ph_whole_member *m = &w->members[i];
    size_t state, values = about->ports ? 4 * doubles((size_t)about->ports->n) : 0;
    m->map = ph_whole_map(about, &m->about);
    m->map->sizes(m->about, &m->sizes);
    ph_places(&m->sizes, m->offset);
    m->of = calloc(1, m->map->size(m->about));
    if (!m->of || m->map->init(m->of, m->about) != PH_OK)
        return 0;
    if (about->unit)
        return 1;
    m->in = m->of;
    state = ph_padded(ph_state_size(m->in));
    m->states = calloc(1, 2 * state + values + 1);
    if (!m->states)
        return 0;
    m->native = about->native;
    m->native.in = m->in;
    m->native.signals = ph_signals(m->in);
    m->native.kept = m->states;
    m->native.copied = (double *)(void *)((char *)m->states + state);
    m->native.kept_values = (double *)(void *)((char *)m->states + 2 * state);
    if (about->ports) {
        void *memory = calloc(1, ph_impulses_size(m->in, about->ports));
        if (!memory)
            return 0;
        m->kicks = ph_impulses_init(memory, m->in, about->ports);
        m->native.kicks = m->kicks;
        m->native.values = ph_impulse_values(m->kicks);
    }
    if (!about->held && about->share.ninput + 2 * about->share.nbare > 0) {
        m->chain = calloc(1, ph_size(about->model));
        if (!m->chain || ph_init(m->chain, about->model) != PH_OK)
            return 0;
        m->native.chain = m->chain;
    }
    return 1;
}

/* Pointers of a structure into the memory of all. */
static void furnish(const ph_whole *w, void *of, const ph_room *rooms, int n) {
    for (int i = 0; i < n; i++) {
        void *to = (char *)w->room + rooms[i].first;
        memcpy((char *)of + rooms[i].at, &to, sizeof(to));
    }
}

static void place_members(ph_whole *w) {
    int at[PH_NBLOCK], u = 0, p = 0, pairs = 0, comp = 0;
    memcpy(at, w->offset, sizeof(at));
    for (int i = 0; i < w->about->nmember; i++) {
        ph_whole_member *m = &w->members[i];
        const ph_sizes *own = &m->sizes;
        for (int b = 0; b < PH_NBLOCK; b++) {
            m->first[b] = at[b];
            at[b] += b == PH_TIME ? 0 : m->offset[b + 1] - m->offset[b];
        }
        m->u = u;
        m->p = p;
        m->pairs = pairs;
        m->comp = comp;
        u += own->nu;
        p += own->np;
        pairs += own->nq;
        comp += own->ncomp;
    }
}

/* Of the shares, the most inputs. */
static int widest(const ph_network *n) {
    int most = 0;
    for (int i = 0; i < n->nmember; i++)
        most = n->members[i].share.nu > most ? n->members[i].share.nu : most;
    return most;
}

/* Bytes of the factors, in all modes. */
static size_t lu_size(const ph_network *n) {
    const ph_master *m = &n->master;
    const int size = m->nxi + 2 * m->nbare;
    size_t most = ph_master_lu_size(size, m->nnz, m->capacity);
    for (int i = 0; i < n->nrows; i++) {
        const size_t own = ph_master_lu_size(size, n->rows[i].nnz, n->rows[i].capacity);
        most = own > most ? own : most;
    }
    return most;
}

/* Values of this structure, one after the other. */
static int lay_values(ph_whole *w) {
    const int n = w->master.ncolumn, nc = w->sizes.ncomp, all = ph_whole_njoined(w->about, w->sizes.nu);
    const size_t counts = PH_NCOUNT, row = 5 * (size_t)nc + (size_t)w->sizes.nq;
    const int none = widest(w->about);
    const size_t size = 1 + (size_t)w->offset[PH_NBLOCK] + row + (size_t)w->sizes.np + (size_t)w->sizes.nu +
                        2 * (size_t)n + (size_t)none + (size_t)all + (size_t)ph_whole_kept_size(w->about) +
                        2 * (size_t)nc;
    w->work = calloc(size + 1, sizeof(double));
    w->count = calloc(counts, sizeof(long long));
    if (!w->work || !w->count)
        return 0;
    w->table = w->work;
    w->row[0] = w->table + w->offset[PH_NBLOCK];
    for (int i = 1; i < PH_NROW; i++)
        w->row[i] = w->row[i - 1] + nc;
    w->p = w->row[PH_ROW_PAIRS] + w->sizes.nq;
    w->free = w->p + w->sizes.np;
    w->mean = w->free + w->sizes.nu;
    w->begin = w->mean + n;
    w->none = w->begin + n;
    w->joined = w->none + none;
    w->kept = w->joined + all;
    w->happened.energy = w->kept + ph_whole_kept_size(w->about);
    w->happened.lost = w->happened.energy + nc;
    w->h = w->happened.lost + nc;
    return 1;
}

static int make_master(ph_whole *w) {
    const ph_network *n = w->about;
    ph_master *m = &w->master;
    w->room = calloc(1, n->room + 1);
    w->lu = calloc(1, lu_size(n) + 1);
    w->memory = malloc(n->memory_size + 1);
    if (!w->room || !w->lu || !w->memory)
        return 0;
    for (int i = 0; i < n->nmember; i++) {
        const ph_network_member *about = &n->members[i];
        ph_whole_member *own = &w->members[i];
        ph_share *s = &w->shares[i];
        *s = about->share;
        const double *signals = own->map->signals(own->of);
        furnish(w, s, about->rooms, about->nroom);
        furnish(w, &own->native, about->rooms + about->nroom, about->nnative);
        s->kind = about->unit ? about->unit->kind() : ph_kind_native();
        s->of = about->unit ? own->of : &own->native;
        if (about->inside) {
            own->inside = about->inside->make(about->inside, &own->native);
            if (!own->inside)
                return 0;
            s->of = own->inside;
            s->kind = about->inside->kind(own->inside);
        }
        s->free = s->nu == own->sizes.nu ? w->free + own->u : w->none;
        s->outputs = about->held ? signals + own->offset[PH_Y_STEP] : own->map->node_outputs(own->of);
        s->energies = signals + own->offset[PH_H];
        s->end = signals + own->offset[PH_Y_END];
    }
    furnish(w, m, n->rooms, n->nroom);
    w->held = n->held;
    furnish(w, &w->held, n->held_rooms, n->nheld);
    m->held = n->held.n ? &w->held : NULL;
    if (n->memory_size)
        memcpy(w->memory, n->memory, n->memory_size);
    furnish(w, w->memory, n->memory_rooms, n->nmemory);
    m->solver = n->solver();
    m->memory = w->memory;
    m->rules = &n->rules;
    m->shares = w->shares;
    m->lu = w->lu;
    ph_master_lu_init(m);
    if (n->lander)
        w->lander = n->lander->make(w, n->lander);
    if (n->lander && !w->lander)
        return 0;
    w->before = calloc(1, ph_whole_state_size(w));
    return w->before != NULL;
}

int ph_whole_make(ph_whole *w) {
    const ph_network *n = w->about;
    w->members = calloc((size_t)n->nmember, sizeof(ph_whole_member));
    w->shares = calloc((size_t)n->nmember, sizeof(ph_share));
    for (int i = 0; w->members && w->shares && i < n->nmember; i++)
        if (!make_member(w, i))
            return 0;
    if (!w->members || !w->shares || !lay_values(w))
        return 0;
    place_members(w);
    return make_master(w);
}

void ph_whole_release(void *of) {
    ph_whole *w = of;
    if (w->before)
        ph_whole_forget(w, w->before);
    if (w->lander)
        w->about->lander->release(w->lander);
    for (int i = 0; w->members && i < w->about->nmember; i++) {
        const ph_whole_member *m = &w->members[i];
        if (m->of && m->map->release)
            m->map->release(m->of);
        free(m->of);
        free(w->members[i].kicks);
        free(w->members[i].chain);
        free(w->members[i].states);
        free(w->members[i].inside);
    }
    free(w->members);
    free(w->shares);
    free(w->room);
    free(w->lu);
    free(w->memory);
    free(w->work);
    free(w->count);
    free(w->before);
}
