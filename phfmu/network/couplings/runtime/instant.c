/* Unknowns of the junctions at one instant: instant.py, with what has changed looked at only. A member that
 * has stepped changes rows of its own junctions; what these make of the unknowns others are asked for, and so
 * on. The matrix falls into blocks, which are solved by themselves. */
#include "instant.h"

#include <math.h>
#include <string.h>

#include "system.h"

static void mark(int *n, int *list, int *marked, int i) {
    if (marked[i])
        return;
    marked[i] = 1;
    list[(*n)++] = i;
}

static void unmark(int *n, const int *list, int *marked) {
    for (int i = 0; i < *n; i++)
        marked[list[i]] = 0;
    *n = 0;
}

int ph_instant_give(ph_master *m, int share, const double *u) {
    const ph_in_turn *t = m->memory;
    const ph_share *s = &m->shares[share];
    if (t->asked[share] != PH_UNGIVEN && memcmp(s->now, u, sizeof(double) * (size_t)s->nu) == 0)
        return PH_OK;
    memcpy(s->now, u, sizeof(double) * (size_t)s->nu);
    t->asked[share] = PH_GIVEN;
    return s->kind->present(s);
}

void ph_instant_begin(ph_master *m) {
    ph_in_turn *t = m->memory;
    unmark(&t->nshare, t->share, t->share_marked);
    unmark(&t->nrow, t->row, t->row_marked);
    for (int i = 0; i < m->nshare; i++) {
        if (m->held) /* which have been set since */
            t->asked[i] = PH_UNGIVEN;
        ph_instant_ask(t, i);
    }
}

void ph_instant_ask(ph_in_turn *t, int share) {
    mark(&t->nshare, t->share, t->share_marked, share);
}

/* Outputs of a share that is marked, under z. */
static void one_asked(void *with, int i) {
    ph_master *m = with;
    const ph_in_turn *t = m->memory;
    const int share = t->share[i];
    const ph_share *s = &m->shares[share];
    int status;
    ph_share_inputs(m, s, s->y);
    status = ph_instant_give(m, share, s->y);
    if (status == PH_OK && t->asked[share] != PH_ASKED)
        status = s->kind->refresh(s);
    t->asked[share] = PH_ASKED;
    m->status[share] = status;
}

/* Of all of them, whose rows are marked then. */
static int ask(ph_master *m, ph_in_turn *t) {
    int status = PH_OK;
    ph_crew_each(m->crew, t->nshare, one_asked, m);
    for (int i = 0; i < t->nshare; i++) {
        const ph_share *s = &m->shares[t->share[i]];
        if (m->status[t->share[i]])
            status = m->status[t->share[i]];
        for (int r = 0; r < s->nrow; r++)
            mark(&t->nrow, t->row, t->row_marked, s->row[r]);
    }
    unmark(&t->nshare, t->share, t->share_marked);
    return status;
}

/* The largest scaled residual of the rows that are marked. */
static double residual(ph_master *m, const ph_in_turn *t) {
    double worst = 0.0;
    for (int i = 0; i < t->nrow; i++) {
        const int r = t->row[i];
        double sum = 0.0, size = 0.0, scaled;
        for (int e = t->term[r]; e < t->term[r + 1]; e++) {
            const double y = t->term_value[e] * m->shares[t->term_share[e]].end[t->term_output[e]];
            sum += y;
            size += fabs(y);
        }
        for (int e = t->skew[r]; e < t->skew[r + 1]; e++) {
            const double x = m->skew[t->skew_entry[e]] * m->z[m->skew_col[t->skew_entry[e]]];
            sum += x;
            size += fabs(x);
        }
        m->rows[r] = sum;
        scaled = fabs(sum) / (size + m->least[r]);
        if (!isfinite(scaled))
            return INFINITY;
        worst = fmax(worst, scaled);
    }
    return worst;
}

/* dy of one share at the present time, by differences along its inputs. */
static int differences(ph_in_turn *t, const ph_share *s) {
    int status = PH_OK;
    memcpy(t->base, s->end, sizeof(double) * (size_t)s->nu);
    for (int d = 0; d < s->ninput && status == PH_OK; d++) {
        const int j = s->input[d];
        const double u = s->now[j], moved = u + PH_INSTANT_MOVE * (fabs(u) + s->nominal[j]);
        s->now[j] = moved;
        status = s->kind->present(s);
        if (status == PH_OK)
            status = s->kind->refresh(s);
        s->now[j] = u;
        for (int i = 0; i < s->nu; i++) {
            const double change = s->end[i] - t->base[i];
            s->dy[d * s->nu + i] =
                fabs(change) <= PH_INSTANT_ROUNDING * fabs(t->base[i]) ? 0.0 : change / (moved - u);
        }
    }
    if (status == PH_OK)
        status = s->kind->present(s);
    return status ? status : s->kind->refresh(s);
}

static int along(ph_master *m) {
    for (int i = 0; i < m->nshare; i++) {
        const ph_share *s = &m->shares[i];
        const int status = s->ninput ? ph_share_said(m, i, differences(m->memory, s)) : PH_OK;
        if (status)
            return status;
        if (s->ninput)
            ph_share_across(s);
    }
    return PH_OK;
}

static int root(int *label, int i) {
    for (; label[i] != i; i = label[i])
        label[i] = label[label[i]];
    return i;
}

/* Blocks of the matrix as its numbers are, and which steps of elimination belong to each. */
static void part(const ph_master *m, ph_in_turn *t) {
    const ph_lu *lu = m->lu;
    const int n = m->nxi;
    for (int i = 0; i < 2 * n; i++)
        t->label[i] = i;
    for (int j = 0; j < n; j++)
        for (int e = m->colptr[j]; e < m->colptr[j + 1]; e++)
            if (m->a[e] != 0.0) {
                const int a = root(t->label, m->rowind[e]), b = root(t->label, n + j);
                t->label[a > b ? a : b] = a > b ? b : a; /* the root is a row */
            }
    for (int i = 0; i < 2 * n; i++)
        t->label[i] = t->label[t->label[i]];
    memset(t->first, 0, sizeof(int) * (size_t)(n + 1));
    for (int j = 0; j < n; j++)
        t->first[t->label[n + j] + 1]++;
    for (int j = 0; j < n; j++)
        t->first[j + 1] += t->first[j];
    for (int j = 0; j < n; j++)
        t->step[t->first[t->label[n + lu->order[j]]]++] = j;
    memmove(t->first + 1, t->first, sizeof(int) * (size_t)n);
    t->first[0] = 0;
}

/* The unknowns of one block by its rows; shares that they feed are marked. */
static void solve_block(ph_master *m, ph_in_turn *t, int b) {
    ph_lu *lu = m->lu;
    double *y = lu->work;
    for (int i = t->first[b]; i < t->first[b + 1]; i++) {
        const int row = lu->pivot[t->step[i]];
        y[t->step[i]] = m->rows[row] * m->scale[row];
    }
    for (int i = t->first[b]; i < t->first[b + 1]; i++) {
        const int j = t->step[i];
        for (int l = lu->lower[j]; l < lu->start[j + 1]; l++)
            y[lu->index[l]] -= lu->value[l] * y[j];
    }
    for (int i = t->first[b + 1] - 1; i >= t->first[b]; i--) {
        const int j = t->step[i], unknown = lu->order[j];
        const double move = y[j] * lu->inverse[j];
        y[j] = 0.0;
        m->z[unknown] -= move;
        for (int q = lu->start[j]; q < lu->lower[j]; q++)
            y[lu->index[q]] -= lu->value[q] * move;
        for (int e = t->fed[unknown]; e < t->fed[unknown + 1] && move != 0.0; e++)
            ph_instant_ask(t, t->fed_share[e]);
    }
}

int ph_instant_factor(ph_master *m) {
    const int status = ph_matrix_factor(m);
    if (status == PH_OK)
        part(m, m->memory);
    return status;
}

static int update(ph_master *m, ph_in_turn *t, int anew) {
    if (anew) {
        int status = ph_matrix_of(m, along);
        if (status == PH_OK)
            status = ph_instant_factor(m);
        if (status)
            return status;
        t->begun = 1;
    }
    for (int i = 0; i < t->nrow; i++)
        mark(&t->nblock, t->block, t->block_marked, t->label[t->row[i]]);
    ph_lap(m->clock, PH_SOLVING);
    for (int i = 0; i < t->nblock; i++)
        solve_block(m, t, t->block[i]);
    ph_lap(m->clock, PH_JOINING);
    unmark(&t->nblock, t->block, t->block_marked);
    return PH_OK;
}

int ph_instant_solve(ph_master *m) {
    ph_in_turn *t = m->memory;
    double before = INFINITY;
    for (int i = 0; i < PH_INSTANT_ITERATIONS; i++) {
        int stays, status = ask(m, t);
        double worst;
        if (status)
            return status;
        worst = residual(m, t);
        if (!isfinite(worst))
            return PH_NOT_FINITE;
        stays = worst > PH_INSTANT_SHRINKING * before;
        if (worst <= PH_INSTANT_SOLVED || (stays && worst <= PH_INSTANT_STALLED)) {
            unmark(&t->nrow, t->row, t->row_marked);
            return PH_OK;
        }
        status = update(m, t, !t->begun || stays);
        if (status)
            return status;
        before = worst;
    }
    return PH_NO_CONVERGENCE;
}
