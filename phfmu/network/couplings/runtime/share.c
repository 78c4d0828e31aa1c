/* A member's part of a step: its trial, what that adds to the rows and to the matrix. */
#include <math.h>
#include <string.h>

#include "master.h"
#include "system.h"

static size_t bytes(int n) {
    return sizeof(double) * (size_t)n;
}

void ph_share_keep(const ph_share *s) {
    s->calls->save(s->in, s->kept);
    if (s->impulses)
        memcpy(s->kept_values, s->values, bytes(4 * s->impulses));
}

int ph_share_restore(const ph_share *s) {
    if (s->impulses)
        memcpy(s->values, s->kept_values, bytes(4 * s->impulses));
    return s->calls->load(s->in, s->kept);
}

static int look(const ph_share *s) {
    int status = s->nkick ? s->calls->refresh(s->in) : PH_OK;
    if (s->nkick && status == PH_OK)
        s->calls->jump(s->kicks, s->jump);
    return status;
}

static void add_sums(const ph_share *s, int nxi, double *sums) {
    for (int e = 0; s->nkick && e < s->nleft; e++)
        if (s->left_output[e] >= s->k * s->nu)
            sums[s->row[s->left_row[e]] - nxi] += s->left[e] * s->end[s->left_output[e] - s->k * s->nu];
}

static void add_jump(const ph_share *s, double *S) {
    for (int i = 0; i < s->nkick * s->nkick; i++)
        if (s->jump_entry[i] >= 0)
            S[s->jump_entry[i]] += s->jump[i];
}

int ph_share_before(const ph_share *s, int nxi, double *S, double *sums) {
    int status = look(s);
    if (status)
        return status;
    add_sums(s, nxi, sums);
    add_jump(s, S);
    return PH_OK;
}

int ph_share_end(const ph_share *s, int nxi, double *sums) {
    int status = s->nkick ? s->calls->refresh(s->in) : PH_OK;
    if (status == PH_OK)
        add_sums(s, nxi, sums);
    return status;
}

static int step(const ph_share *s, double t, double h) {
    int status = (s->chain ? s->calls->set_node_inputs : s->calls->set_input)(s->in, s->u);
    if (status == PH_OK && s->nkick)
        status = s->calls->set_impulses(s->kicks, s->s);
    if (status)
        return status;
    return s->kicks ? s->calls->step_impulses(s->kicks, t, h, s->parts)
                    : s->calls->step_parts(s->in, t, h, s->parts);
}

/* Where what is along direction d goes: an input, or an impulse. */
static double *place(const ph_share *s, int d) {
    const int i = d - s->ninput;
    if (i < 0)
        return s->u + s->input[d];
    return i < s->nbare ? s->s + s->kicked[i] : s->s + s->nkick + s->kicked[i - s->nbare];
}

int ph_share_step(const ph_master *m, const ph_share *s, double t, double h) {
    const int kn = s->k * s->nu;
    int status;
    ph_clear(s->u, kn);
    ph_clear(s->s, 2 * s->nkick);
    for (int e = 0; e < s->nright; e++)
        *place(s, s->right_direction[e]) += s->right[e] * m->z[s->col[s->right_col[e]]];
    if (s->given)
        for (int i = 0; i < kn; i++)
            s->u[i] += s->given[(ptrdiff_t)m->row * kn + i];
    else
        for (int i = 0; i < kn; i++)
            s->u[i] += s->free[i % s->nu];
    status = step(s, t, h);
    return status ? status : look(s);
}

int ph_share_more(const ph_master *m, const ph_share *s, const double *more) {
    const int ends = s->ninput + s->nbare, first = m->nxi + m->nbare;
    ph_clear(s->s, s->nkick);
    for (int e = 0; e < s->nright; e++)
        if (s->right_direction[e] >= ends)
            s->s[s->kicked[s->right_direction[e] - ends]] +=
                s->right[e] * more[s->col[s->right_col[e]] - first];
    return s->nkick ? s->calls->kick_more(s->kicks, s->s) : PH_OK;
}

void ph_share_add_rows(ph_master *m, const ph_share *s, double h, double *through) {
    const int kn = s->k * s->nu;
    add_sums(s, m->nxi, m->rows + m->nxi);
    add_jump(s, m->S1);
    for (int i = 0; i < s->k; i++)
        for (int j = 0; j < s->nu; j++) {
            const double y = s->outputs[i * s->nq + j];
            s->y[i * s->nu + j] = y;
            *through += fabs(h) * s->weights[i] * fabs(s->u[i * s->nu + j]) * fabs(y);
        }
    for (int e = 0; e < s->nleft; e++) {
        const int i = s->left_output[e], r = s->row[s->left_row[e]];
        const double y = i < kn ? s->y[i] : s->end[i - kn];
        if (i < kn)
            m->rows[r] += s->left[e] * y;
        m->size[r] += fabs(s->left[e]) * fabs(y);
    }
}

/* dy of held inputs, one value each. */
static int held(const ph_share *s) {
    double *S = s->dx;
    int status = s->calls->sensitivity(s->in, S);
    for (int d = 0; d < s->ninput; d++)
        for (int i = 0; i < s->nu; i++)
            s->dy[d * s->nu + i] = S[i * s->nu + s->input[d]];
    return status;
}

/* dy and dend along all directions; impulses at the end change outputs there only, by their jump. */
static int along(const ph_share *s) {
    const int through = s->ninput + s->nbare, kn = s->k * s->nu;
    const ph_directions nodes = {through, s->du, s->dx, s->dy}, end = {through, s->du, s->dx, s->dend};
    int status;
    ph_clear(s->dx, through * s->width);
    if (s->nkick)
        s->calls->impulses_along(s->kicks, 0, s->nbare, s->ds, s->dx + s->ninput * s->width);
    s->calls->save(s->in, s->copied);
    status = s->chain_calls->load(s->chain, s->copied);
    if (status == PH_OK)
        status = s->chain_calls->step_along(s->chain, &nodes);
    if (!s->nkick || status)
        return status;
    ph_clear(s->dy + through * kn, s->nbare * kn);
    ph_clear(s->dend + through * s->nu, s->nbare * s->nu);
    for (int j = 0; j < s->nbare; j++)
        for (int i = 0; i < s->nbare; i++)
            s->dend[(through + j) * s->nu + s->kicked_output[i]] =
                s->jump[s->kicked[i] * s->nkick + s->kicked[j]];
    s->calls->impulses_along(s->kicks, 1, through, s->ds_end, s->dx);
    return s->chain_calls->end_along(s->chain, &end);
}

int ph_share_along(const ph_share *s) {
    const int all = s->ninput + 2 * s->nbare, kn = s->k * s->nu;
    int status;
    if (all == 0)
        return PH_OK;
    status = s->chain ? along(s) : held(s);
    if (status)
        return status;
    ph_clear(s->across, s->nrow * all);
    for (int e = 0; e < s->nleft; e++) {
        const int i = s->left_output[e];
        const double *from = i < kn ? s->dy + i : s->dend + i - kn;
        double *to = s->across + s->left_row[e] * all;
        for (int d = 0; d < all; d++)
            to[d] += s->left[e] * from[d * (i < kn ? kn : s->nu)];
    }
    return PH_OK;
}

void ph_share_add_matrix(ph_master *m, const ph_share *s) {
    const int all = s->ninput + 2 * s->nbare;
    for (int e = 0; all && e < s->nright; e++)
        for (int r = 0; r < s->nrow; r++)
            m->a[s->entry[r * s->ncol + s->right_col[e]]] +=
                s->across[r * all + s->right_direction[e]] * s->right[e];
}

void ph_share_record(const ph_share *s, int row) {
    const int length = s->nsignal + 5 * s->ncomp + s->nq;
    double *to = s->record + (ptrdiff_t)row * length;
    memcpy(to, s->signals, bytes(s->nsignal));
    to += s->nsignal;
    for (int i = 0; i < PH_NROW; i++) {
        const int n = i == PH_ROW_PAIRS ? s->nq : s->ncomp;
        if (n)
            memcpy(to, s->calls->ledger(s->in, i), bytes(n));
        to += n;
    }
}
