/* The steps of coupled members: Newton's method over their unknowns, and rows of what was accepted. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "master.h"
#include "system.h"

static size_t bytes(int n) {
    return sizeof(double) * (size_t)n;
}

/* One trial: what its rows leave, in scaled size and in energy, and the energy in play as far as it is known.
 */
typedef struct trial {
    double scaled;
    double left;
    double through;
    double in_play; /* negative: not asked for yet */
} trial;

/* How an iteration went so far. */
typedef struct progress {
    int trials;
    int stalled;
    int stalls;
    int taken; /* matrices */
    double before;
} progress;

static int all_finite(const double *values, int n) {
    double sum = 0.0;
    for (int i = 0; i < n; i++)
        sum += values[i] - values[i];
    return sum == 0.0;
}

static char *room(char **at, size_t size) {
    char *here = *at;
    *at += (size + 15) / 16 * 16;
    return here;
}

static size_t lay_lu(ph_lu *lu, char *base) {
    const size_t n = (size_t)lu->n, real = sizeof(double), whole = sizeof(int);
    char *at = base;
    room(&at, sizeof(*lu));
    lu->value = (double *)room(&at, real * (size_t)lu->capacity);
    lu->inverse = (double *)room(&at, real * n);
    lu->work = (double *)room(&at, real * n);
    lu->index = (int *)room(&at, whole * (size_t)lu->capacity);
    lu->pivot = (int *)room(&at, whole * n);
    lu->where = (int *)room(&at, whole * n);
    lu->start = (int *)room(&at, whole * (n + 1));
    lu->lower = (int *)room(&at, whole * n);
    lu->place = (int *)room(&at, whole * (size_t)lu->nnz);
    lu->mark = (int *)room(&at, whole * n);
    lu->stack = (int *)room(&at, whole * n);
    lu->child = (int *)room(&at, whole * n);
    return (size_t)(at - base);
}

size_t ph_master_lu_size(int n, int nnz, int capacity) {
    double here[1];
    ph_lu lu = {.n = n, .nnz = nnz, .capacity = capacity};
    return lay_lu(&lu, (char *)here);
}

void ph_master_lu_init(ph_master *m) {
    ph_lu *lu = m->lu;
    *lu = (ph_lu){.n = m->nxi + 2 * m->nbare, .nnz = m->nnz, .capacity = m->capacity};
    lu->colptr = m->colptr;
    lu->rowind = m->rowind;
    lu->order = m->order;
    lu->prefer = m->prefer;
    lay_lu(lu, m->lu);
}

/* x S x on the clusters. */
static double form(const ph_master *m, const double *S, const double *x) {
    double sum = 0.0;
    for (int c = 0; c < m->ncluster; c++) {
        const int from = m->cluster[c], n = m->cluster[c + 1] - from;
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++)
                sum += x[from + i] * S[m->square[c] + i * n + j] * x[from + j];
    }
    return sum;
}

/* S and sums of the members where they are. */
static int before(ph_master *m) {
    ph_clear(m->S0, m->square[m->ncluster]);
    ph_clear(m->sums, m->nbare);
    for (int i = 0; i < m->nshare; i++) {
        int status = ph_share_end(m, &m->shares[i], m->S0, m->sums);
        if (status)
            return status;
    }
    return PH_OK;
}

static int restore(ph_master *m) {
    int status = PH_OK;
    for (int i = 0; i < m->nshare && status == PH_OK; i++)
        status = ph_share_restore(&m->shares[i]);
    return status;
}

/* One step of all members under z, and what their rows leave. */
static int attempt(ph_master *m, double t, double h, trial *found) {
    const int n = m->nxi, nb = m->nbare;
    const double *start = m->z + n, *end = start + nb;
    int status;
    ph_clear(m->rows, n + nb);
    ph_clear(m->size, n + nb);
    ph_clear(m->S1, m->square[m->ncluster]);
    *found = (trial){.in_play = -1.0};
    for (int e = 0; e < m->nskew; e++) {
        const double term = m->skew[e] * m->z[m->skew_col[e]];
        m->rows[m->skew_row[e]] += term;
        m->size[m->skew_row[e]] += fabs(term);
    }
    for (int i = 0; i < m->nshare; i++) {
        status = ph_share_trial(m, &m->shares[i], t, h, &found->through);
        if (status)
            return status;
    }
    status = ph_pair_moved(m);
    if (status)
        return status;
    for (int i = 0; i < n; i++)
        found->left += fabs(h) * m->weights[i] * fabs(m->z[i] * m->rows[i]);
    for (int b = 0; b < nb; b++) {
        m->rows[n + nb + b] = end[b] - m->signs[b] * m->moved[b];
        found->left += fabs(start[b] * m->sums[b]) + fabs(end[b] * m->rows[n + b]);
    }
    if (nb)
        found->left += fabs(form(m, m->S0, start) - form(m, m->S1, end)) / 2.0;
    for (int i = 0; i < n + nb; i++) {
        const double scaled = fabs(m->rows[i]) / (m->size[i] + m->least[i]);
        if (scaled > found->scaled)
            found->scaled = scaled;
    }
    return all_finite(m->rows, n + 2 * nb) ? PH_OK : PH_NOT_FINITE;
}

/* Whether the energy left is below so many budgets; stored energies are asked for only where power does not
 * do. */
static int within(ph_master *m, trial *now, double budgets) {
    const double budget = budgets * m->rules->energy;
    if (now->left <= budget * now->through)
        return 1;
    if (now->in_play < 0.0) {
        now->in_play = now->through;
        double stored = 0.0;
        for (int i = 0; i < m->nshare; i++) {
            if (m->shares[i].calls->refresh(m->shares[i].in))
                return 0;
            for (int c = 0; c < m->shares[i].ncomp; c++)
                stored += fabs(m->shares[i].energies[c]);
        }
        if (stored > now->in_play)
            now->in_play = stored;
    }
    return now->left <= budget * now->in_play;
}

/* Whether rows are what a relative change of the unknowns by eps makes of them, with the last matrix. */
static int at_floor(ph_master *m) {
    const int n = m->nxi + m->nbare, all = n + m->nbare;
    ph_clear(m->move, all);
    for (int j = 0; j < all; j++)
        for (int e = m->colptr[j]; e < m->colptr[j + 1]; e++)
            m->move[m->rowind[e]] += fabs(m->a[e]) * fabs(m->z[j]);
    for (int i = 0; i < n; i++)
        if (fabs(m->rows[i]) > m->rules->floor * DBL_EPSILON * m->move[i])
            return 0;
    return 1;
}

/* The rules of newton.py. */
static ph_accepted accepted_held(ph_master *m, trial *now, const progress *p) {
    const ph_rules *rules = m->rules;
    if (p->stalled && at_floor(m))
        return PH_BY_FLOOR;
    if (!within(m, now, 1.0) && !(p->stalled && within(m, now, rules->stalled)))
        return PH_NOT_YET;
    if (now->scaled <= rules->rounding)
        return PH_BY_ENERGY;
    if (p->stalled && now->scaled <= rules->stagnation)
        return PH_BY_FLOOR;
    return p->stalls >= rules->stalls && within(m, now, 1.0) ? PH_BY_FLOOR : PH_NOT_YET;
}

/* The rules of node_newton.py. */
static ph_accepted accepted_nodes(ph_master *m, trial *now, const progress *p) {
    if (p->stalled && p->taken && at_floor(m))
        return PH_BY_FLOOR;
    if (!within(m, now, 1.0))
        return PH_NOT_YET;
    if (now->scaled <= m->rules->rounding)
        return PH_BY_ENERGY;
    return p->taken > 1 && p->stalls >= m->rules->stalls ? PH_BY_FLOOR : PH_NOT_YET;
}

/* Derivatives of all rows with respect to z, of the last trial, and their factors with rows scaled by their
 * largest entries. */
static int take_matrix(ph_master *m) {
    const int n = m->nxi, nb = m->nbare, all = n + 2 * nb;
    long long count[PH_NCOUNT] = {0};
    int status;
    ph_clear(m->a, m->nnz);
    for (int e = 0; e < m->nskew; e++)
        m->a[m->skew_entry[e]] += m->skew[e];
    for (int i = 0; i < m->nshare; i++) {
        status = ph_share_matrix(m, &m->shares[i]);
        if (status)
            return status;
    }
    status = ph_pair_root(m);
    if (status)
        return status;
    for (int c = 0; c < m->ncluster; c++) {
        const int from = m->cluster[c], size = m->cluster[c + 1] - from;
        for (int i = 0; i < size; i++)
            for (int j = 0; j < size; j++) {
                const int e = m->square[c] + i * size + j;
                m->a[m->law_entry[e]] = -m->signs[from + i] * m->T[e];
            }
    }
    for (int b = 0; b < nb; b++)
        m->a[m->own_entry[b]] = 1.0;
    ph_clear(m->scale, all);
    for (int e = 0; e < m->nnz; e++)
        if (fabs(m->a[e]) > m->scale[m->rowind[e]])
            m->scale[m->rowind[e]] = fabs(m->a[e]);
    for (int i = 0; i < all; i++)
        m->scale[i] = 1.0 / (m->scale[i] > 1e-300 ? m->scale[i] : 1e-300);
    for (int e = 0; e < m->nnz; e++)
        m->scaled[e] = m->a[e] * m->scale[m->rowind[e]];
    if (!all_finite(m->scaled, m->nnz))
        return PH_NOT_FINITE;
    return ph_lu_factor(m->lu, m->scaled, count);
}

static int update(ph_master *m) {
    const int all = m->nxi + 2 * m->nbare;
    for (int i = 0; i < all; i++)
        m->rows[i] *= m->scale[i];
    ph_lu_solve(m->lu, m->rows, m->move);
    for (int i = 0; i < all; i++)
        m->z[i] -= m->move[i];
    return all_finite(m->z, all) ? PH_OK : PH_NOT_FINITE;
}

static int solve(ph_master *m, double t, double h, int *trials, ph_accepted *by) {
    const ph_rules *rules = m->rules;
    progress p = {0};
    for (; p.trials < rules->iterations; p.trials++) {
        trial now;
        int status = p.trials > 0 ? restore(m) : PH_OK;
        if (status == PH_OK)
            status = attempt(m, t, h, &now);
        if (status)
            return status;
        p.stalled = p.trials > 1 && now.scaled > rules->shrinking * p.before;
        p.stalls += p.trials > 1 && now.scaled > rules->stalling * p.before;
        p.before = now.scaled;
        *by = (rules->held ? accepted_held : accepted_nodes)(m, &now, &p);
        *trials = p.trials + 1;
        if (*by != PH_NOT_YET)
            return PH_OK;
        if (rules->held || p.taken == 0 || (p.stalled && (p.taken < 2 || !within(m, &now, 1.0)))) {
            status = take_matrix(m);
            p.taken++;
        }
        if (status == PH_OK)
            status = update(m);
        if (status)
            return status;
    }
    return PH_NO_CONVERGENCE;
}

/* z = the continuation of the last step, with the line through what that missed in the last two. */
static void go_ahead(ph_master *m) {
    const int all = m->nxi + 2 * m->nbare;
    memcpy(m->plain, m->found, bytes(all));
    ph_clear(m->plain, m->nxi);
    for (int e = 0; e < m->nahead; e++)
        m->plain[m->ahead_to[e]] += m->ahead[e] * m->found[m->ahead_from[e]];
    for (int i = 0; i < all; i++) {
        m->z[i] = m->plain[i];
        if (m->known == 1)
            m->z[i] += m->missed[i];
        else if (m->known == 2)
            m->z[i] += 2.0 * m->missed[i] - m->missed_before[i];
    }
}

/* z is what was found; ahead: it was begun from the continuation. */
static void keep(ph_master *m, int ahead) {
    const int all = m->nxi + 2 * m->nbare;
    for (int i = 0; i < all && ahead; i++) {
        m->missed_before[i] = m->missed[i];
        m->missed[i] = m->z[i] - m->plain[i];
    }
    m->known = ahead ? (m->known > 0 ? 2 : 1) : 0;
    memcpy(m->found, m->z, bytes(all));
}

static void record(ph_master *m, double h, int row) {
    double *xi = m->xi + (ptrdiff_t)row * m->ncolumn;
    ph_clear(xi, m->ncolumn);
    for (int i = 0; i < m->nxi; i++)
        xi[m->column[i]] += m->weights[i] * m->z[i];
    for (int b = 0; b < m->nbare; b++)
        xi[m->bare_column[b]] += (m->z[m->nxi + b] + m->z[m->nxi + m->nbare + b]) / h;
    for (int i = 0; i < m->nshare; i++)
        ph_share_record(&m->shares[i], row);
}

int ph_master_run(ph_master *m, double t0, double h, int n, long long first, int next) {
    int done = 0, status = before(m);
    for (; done < n && status == PH_OK; done++) {
        ph_accepted by = PH_NOT_YET;
        double *swap;
        if (done || next)
            go_ahead(m);
        for (int i = 0; i < m->nshare; i++)
            ph_share_keep(&m->shares[i]);
        status = solve(m, t0 + (double)(first + done) * h, h, &m->trials[done], &by);
        for (int i = 0; i < m->nshare && status == PH_OK; i++)
            status = m->shares[i].calls->refresh(m->shares[i].in);
        if (status) {
            restore(m);
            break;
        }
        m->accepted[done] = by;
        record(m, h, done);
        ph_work_record(m, h, done);
        keep(m, done || next);
        memcpy(m->sums, m->rows + m->nxi, bytes(m->nbare));
        swap = m->S0;
        m->S0 = m->S1;
        m->S1 = swap;
    }
    return done;
}
