/* A member's part of a step, of whatever kind it is: its trial, what that adds to the rows and to the matrix.
 */
#include <math.h>

#include "master.h"
#include "system.h"

/* Relative change of an input in differences. */
#define PH_SHARE_MOVE 1e-6

static int look(const ph_share *s) {
    int status = s->nkick ? s->kind->refresh(s) : PH_OK;
    return s->nkick && status == PH_OK ? s->kind->jump(s) : status;
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
    int status = s->nkick ? s->kind->refresh(s) : PH_OK;
    if (status == PH_OK)
        add_sums(s, nxi, sums);
    return status;
}

void ph_share_inputs(const ph_master *m, const ph_share *s, double *u) {
    const int kn = s->k * s->nu;
    ph_clear(u, kn);
    for (int e = 0; e < s->nright; e++)
        if (s->right_direction[e] < s->ninput)
            u[s->input[s->right_direction[e]]] += s->right[e] * m->z[s->col[s->right_col[e]]];
    if (s->given)
        for (int i = 0; i < kn; i++)
            u[i] += s->given[(ptrdiff_t)m->row * kn + i];
    else
        for (int i = 0; i < kn; i++)
            u[i] += s->free[i % s->nu];
}

/* s->s = the impulses of the step. */
static void impulses(const ph_master *m, const ph_share *s) {
    ph_clear(s->s, 2 * s->nkick);
    for (int e = 0; s->nkick && e < s->nright; e++) {
        const int i = s->right_direction[e] - s->ninput;
        if (i >= 0)
            s->s[i < s->nbare ? s->kicked[i] : s->nkick + s->kicked[i - s->nbare]] +=
                s->right[e] * m->z[s->col[s->right_col[e]]];
    }
}

int ph_share_step(const ph_master *m, const ph_share *s, double t, double h) {
    int status;
    ph_share_inputs(m, s, s->u);
    impulses(m, s);
    status = s->kind->step(s, t, h);
    return status ? status : look(s);
}

int ph_share_more(const ph_master *m, const ph_share *s, const double *more) {
    const int ends = s->ninput + s->nbare, first = m->nxi + m->nbare;
    ph_clear(s->s, s->nkick);
    for (int e = 0; e < s->nright; e++)
        if (s->right_direction[e] >= ends)
            s->s[s->kicked[s->right_direction[e] - ends]] +=
                s->right[e] * more[s->col[s->right_col[e]] - first];
    return s->nkick ? s->kind->more(s) : PH_OK;
}

void ph_share_add_rows(ph_master *m, const ph_share *s, double h, double *through) {
    const int kn = s->k * s->nu;
    add_sums(s, m->nxi, m->rows + m->nxi);
    add_jump(s, m->S1);
    for (int i = 0; i < s->k; i++)
        for (int j = 0; j < s->nu; j++) {
            const double y = s->outputs[i * s->stride + j];
            s->y[i * s->nu + j] = y;
        }
    for (int d = 0; d < s->ninput; d++) { /* those that junctions feed, not what comes from outside */
        const int at = s->input[d];
        *through += fabs(h) * s->weights[at / s->nu] * fabs(s->u[at]) * fabs(s->y[at]);
    }
    for (int e = 0; e < s->nleft; e++) {
        const int i = s->left_output[e], r = s->row[s->left_row[e]];
        const double y = i < kn ? s->y[i] : s->end[i - kn];
        if (i < kn)
            m->rows[r] += s->left[e] * y;
        m->size[r] += fabs(s->left[e]) * fabs(y);
    }
}

/* The step once more, from where it began, under u and s as they are. */
static int repeated(const ph_master *m, const ph_share *s) {
    int status = s->kind->restore(s);
    if (status == PH_OK)
        status = s->kind->step(s, m->time, m->length);
    if (status == PH_OK)
        status = s->nkick ? look(s) : PH_OK;
    return status;
}

/* dy and dend by one-sided differences, of a step of which the member knows no derivatives; it ends as it
 * was. They are longer where steps are not repeated to rounding. */
static int differences(const ph_master *m, const ph_share *s) {
    const int kn = s->k * s->nu, all = s->ninput + 2 * s->nbare;
    const double part = fmax(PH_SHARE_MOVE, sqrt(m->rules->repeated));
    int status = PH_OK;
    for (int i = 0; s->nkick && i < s->nu; i++)
        s->y[kn + i] = s->end[i];
    for (int d = 0; d < all && status == PH_OK; d++) {
        const int kick = d < s->ninput ? 0 : (d - s->ninput) % s->nbare;
        const int second = d >= s->ninput + s->nbare;
        double *x = d < s->ninput ? s->u + s->input[d] : s->s + second * s->nkick + s->kicked[kick];
        const double kept = *x;
        if (d < s->ninput)
            *x += part * (s->nominal[s->input[d] % s->nu] + fabs(kept));
        else
            *x += part * m->length * s->nominal[s->kicked_output[kick]];
        const double move = *x - kept;
        status = repeated(m, s);
        *x = kept;
        for (int i = 0; i < s->k; i++)
            for (int j = 0; j < s->nu; j++) {
                const int at = i * s->nu + j;
                s->dy[d * kn + at] = (s->outputs[i * s->stride + j] - s->y[at]) / move;
            }
        for (int i = 0; s->nkick && i < s->nu; i++)
            s->dend[d * s->nu + i] = (s->end[i] - s->y[kn + i]) / move;
    }
    return status ? status : repeated(m, s);
}

int ph_share_along(const ph_master *m, const ph_share *s) {
    int status;
    if (s->ninput + s->nbare == 0)
        return PH_OK;
    status = s->kind->along(s);
    if (status)
        status = differences(m, s);
    if (status == PH_OK)
        ph_share_across(s);
    return status;
}

void ph_share_across(const ph_share *s) {
    const int all = s->ninput + 2 * s->nbare, kn = s->k * s->nu;
    ph_clear(s->across, s->nrow * all);
    for (int e = 0; e < s->nleft; e++) {
        const int i = s->left_output[e];
        const double *from = i < kn ? s->dy + i : s->dend + i - kn;
        double *to = s->across + s->left_row[e] * all;
        for (int d = 0; d < all; d++)
            to[d] += s->left[e] * from[d * (i < kn ? kn : s->nu)];
    }
}

void ph_share_add_matrix(ph_master *m, const ph_share *s) {
    const int all = s->ninput + 2 * s->nbare;
    for (int e = 0; all && e < s->nright; e++)
        for (int r = 0; r < s->nrow; r++)
            m->a[s->entry[r * s->ncol + s->right_col[e]]] +=
                s->across[r * all + s->right_direction[e]] * s->right[e];
}
