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

/* The bare columns of the cluster of b are neighbours in S. */
static double *square(const ph_master *m, double *S, int a, int b) {
    int c = 0;
    while (m->cluster[c + 1] <= a)
        c++;
    return S + m->square[c] + (a - m->cluster[c]) * (m->cluster[c + 1] - m->cluster[c]) + b - m->cluster[c];
}

/* sums += of outputs at the present time, S += of the jumps. */
int ph_share_end(ph_master *m, const ph_share *s, double *S, double *sums) {
    int status = s->nkick ? s->calls->refresh(s->in) : PH_OK;
    if (!s->nkick || status)
        return status;
    for (int e = 0; e < s->nleft; e++)
        if (s->left_output[e] >= s->k * s->nu)
            sums[s->row[s->left_row[e]] - m->nxi] += s->left[e] * s->end[s->left_output[e] - s->k * s->nu];
    s->calls->jump(s->kicks, s->jump);
    for (int i = 0; i < s->nkick; i++)
        for (int j = 0; j < s->nkick; j++)
            if (s->bare[i] >= 0 && s->bare[j] >= 0)
                *square(m, S, s->bare[i], s->bare[j]) += s->jump[i * s->nkick + j];
    return PH_OK;
}

static int step(const ph_share *s, double t, double h) {
    int status = (s->chain ? s->calls->set_node_inputs : s->calls->set_input)(s->in, s->u);
    if (status == PH_OK && s->nkick)
        status = s->calls->set_impulses(s->kicks, s->s);
    if (status)
        return status;
    return s->kicks ? s->calls->step_impulses(s->kicks, t, h, 1) : s->calls->step(s->in, t, h);
}

int ph_share_trial(ph_master *m, const ph_share *s, double t, double h, double *through) {
    const int kn = s->k * s->nu;
    int status;
    ph_clear(s->u, kn);
    ph_clear(s->s, 2 * s->nkick);
    for (int e = 0; e < s->nright; e++) {
        const int d = s->right_direction[e];
        double *to = d < s->ninput ? s->u + s->input[d] : s->s + d - s->ninput;
        *to += s->right[e] * m->z[s->col[s->right_col[e]]];
    }
    for (int i = 0; i < kn; i++)
        s->u[i] += s->free[i % s->nu];
    status = step(s, t, h);
    if (status == PH_OK)
        status = ph_share_end(m, s, m->S1, m->rows + m->nxi);
    if (status)
        return status;
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
    return PH_OK;
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

/* dy and dend along all directions; those of impulses at the end change outputs there only. */
static int along(const ph_share *s) {
    const int through = s->ninput + s->nkick, all = through + s->nkick, kn = s->k * s->nu;
    const ph_directions nodes = {through, s->du, s->dx, s->dy}, end = {all, s->du, s->dx, s->dend};
    int status;
    ph_clear(s->dx, all * s->width);
    if (s->nkick)
        s->calls->impulses_along(s->kicks, 0, s->nkick, s->ds, s->dx + s->ninput * s->width);
    s->calls->save(s->in, s->copied);
    status = s->chain_calls->load(s->chain, s->copied);
    if (status == PH_OK)
        status = s->chain_calls->step_along(s->chain, &nodes);
    if (!s->nkick || status)
        return status;
    ph_clear(s->dy + through * kn, s->nkick * kn);
    s->calls->impulses_along(s->kicks, 1, all, s->ds_end, s->dx);
    return s->chain_calls->end_along(s->chain, &end);
}

/* Matrix += left (d outputs / d directions) right. */
int ph_share_matrix(ph_master *m, const ph_share *s) {
    const int all = s->ninput + 2 * s->nkick, kn = s->k * s->nu;
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
    for (int e = 0; e < s->nright; e++)
        for (int r = 0; r < s->nrow; r++)
            m->a[s->entry[r * s->ncol + s->right_col[e]]] +=
                s->across[r * all + s->right_direction[e]] * s->right[e];
    return PH_OK;
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
