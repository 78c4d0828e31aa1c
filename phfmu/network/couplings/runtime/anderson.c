/* Anderson's method over held values (anderson.py), with the least squares by Gram and Schmidt's method, each
 * column twice. */
#include "anderson.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "master.h"
#include "system.h"

static size_t bytes(int n) {
    return sizeof(double) * (size_t)n;
}

/* In four sums, which do not wait for each other. */
static double dot(const double *a, const double *b, int n) {
    double sum[4] = {0.0, 0.0, 0.0, 0.0};
    int i = 0;
    for (; i + 3 < n; i += 4)
        for (int j = 0; j < 4; j++)
            sum[j] += a[i + j] * b[i + j];
    for (; i < n; i++)
        sum[0] += a[i] * b[i];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

static const double *row(const ph_anderson *a, const double *of, int j, int n) {
    return of + (ptrdiff_t)((a->newest + j) % a->room) * n;
}

static void start(ph_master *m, int next) {
    ph_anderson *a = m->memory;
    (void)next;
    a->count_before = a->count;
    a->newest_before = a->newest;
    memcpy(a->size_before, a->size, bytes(m->nxi));
    memcpy(a->from, m->z, bytes(m->nxi));
}

static void drop(ph_master *m) {
    ph_anderson *a = m->memory;
    a->count = a->count_before;
    a->newest = a->newest_before;
    memcpy(a->size, a->size_before, bytes(m->nxi));
}

/* Without the differences of the steps before, which may have led away; of a step that began without there is
 * no other way. */
static int again(ph_master *m, int next) {
    ph_anderson *a = m->memory;
    (void)next;
    if (a->count_before == 0)
        return 0;
    drop(m);
    a->count = 0;
    memcpy(m->z, a->from, bytes(m->nxi));
    return 1;
}

/* One more difference of xi and of f = -move. */
static void add(ph_anderson *a, const double *xi, const double *move, int n) {
    a->newest = (a->newest + a->room - 1) % a->room;
    a->count = a->count < a->most ? a->count + 1 : a->most;
    for (int i = 0; i < n; i++) {
        a->X[a->newest * n + i] = xi[i] - a->xi[i];
        a->F[a->newest * n + i] = -move[i] - a->f[i];
    }
}

/* The differences of f over the sizes of the unknowns, newest first, as rows of Q; their lengths in c. The
 * largest. */
static double scaled(ph_anderson *a, int n) {
    double largest = 0.0;
    for (int j = 0; j < a->count; j++) {
        const double *f = row(a, a->F, j, n);
        double *column = a->Q + j * n;
        for (int i = 0; i < n; i++)
            column[i] = f[i] * a->inverse[i];
        a->c[j] = sqrt(dot(column, column, n));
        largest = fmax(largest, a->c[j]);
    }
    return largest;
}

/* Takes from a column its parts along the q first ones of Q, which it adds to r; what is left of its length.
 */
static double apart(const ph_anderson *a, double *column, double *r, int q, int n) {
    for (int k = 0; k < q; k++) {
        const double *along = a->Q + k * n, part = dot(along, column, n);
        r[k] += part;
        for (int i = 0; i < n; i++)
            column[i] -= part * along[i];
    }
    return sqrt(dot(column, column, n));
}

/* Column j of those that are scaled, without its parts along the q first ones, becomes the next of them, if
 * what is left is more than rounding. A column of which much is left is orthogonal to working accuracy at
 * once, others after a second pass (Parlett, The Symmetric Eigenvalue Problem, 6.9). */
static int orthogonal(ph_anderson *a, int j, int q, int n, double least) {
    double *column = a->Q + q * n, *r = a->R + q * a->most, left;
    const double whole = a->c[j];
    if (q < j)
        memcpy(column, a->Q + j * n, bytes(n));
    ph_clear(r, q);
    left = apart(a, column, r, q, n);
    if (left < PH_ANDERSON_TWICE * whole)
        left = apart(a, column, r, q, n);
    if (!(left > PH_ANDERSON_DROPPED * whole) || left <= least)
        return 0;
    for (int i = 0; i < n; i++)
        column[i] /= left;
    r[q] = left;
    a->kept[q] = j;
    return 1;
}

/* c = argmin |S (f - F c)| for the differences that are kept; their number. */
static int least_squares(ph_anderson *a, int n) {
    int q = 0;
    double largest;
    for (int i = 0; i < n; i++)
        a->inverse[i] = 1.0 / a->size[i];
    largest = scaled(a, n);
    for (int j = 0; j < a->count && q < n; j++)
        q += orthogonal(a, j, q, n, DBL_EPSILON * n * largest);
    for (int i = 0; i < n; i++)
        a->inverse[i] *= a->f[i];
    for (int k = 0; k < q; k++)
        a->c[k] = dot(a->Q + k * n, a->inverse, n);
    for (int k = q - 1; k >= 0; k--) {
        a->c[k] /= a->R[k * a->most + k];
        for (int l = 0; l < k; l++)
            a->c[l] -= a->R[k * a->most + l] * a->c[k];
    }
    return q;
}

static int move(ph_master *m, ph_progress *p, int left) {
    ph_anderson *a = m->memory;
    const int n = m->nxi;
    int q;
    (void)left;
    if (!a->begun) {
        const int status = a->plain ? ph_matrix_plain(m) : ph_matrix_take(m);
        if (status)
            return status;
        a->begun = 1;
    }
    ph_matrix_solve(m);
    for (int i = 0; i < n; i++)
        a->size[i] = fmax(a->size[i], fabs(m->z[i]));
    if (p->trials > 1)
        add(a, m->z, m->move, n);
    for (int i = 0; i < n; i++) {
        a->xi[i] = m->z[i];
        a->f[i] = -m->move[i];
    }
    ph_lap(m->clock, PH_SOLVING);
    q = least_squares(a, n);
    for (int i = 0; i < n; i++)
        m->z[i] += q || !a->plain ? a->f[i] : PH_ANDERSON_FIRST * a->f[i];
    for (int k = 0; k < q; k++) {
        const double *x = row(a, a->X, a->kept[k], n), *f = row(a, a->F, a->kept[k], n);
        for (int i = 0; i < n; i++)
            m->z[i] -= (x[i] + f[i]) * a->c[k];
    }
    p->resting = 1;
    for (int i = 0; i < n; i++)
        p->resting &= fabs(m->z[i] - a->xi[i]) <= PH_COUPLED_FLOOR * DBL_EPSILON * fabs(m->z[i]);
    ph_lap(m->clock, PH_JOINING);
    return ph_all_finite(m->z, n) ? PH_OK : PH_NOT_FINITE;
}

static void forget(ph_master *m) {
    ph_anderson *a = m->memory;
    a->begun = a->count = a->newest = 0;
    for (int i = 0; i < m->nxi; i++)
        a->size[i] = fmax(PH_ANDERSON_SIZE * m->nominal[m->column[i]], 1e-300);
}

/* Whether M is factored, how many differences there are, sizes, M, differences of xi and of f, newest first.
 */
static int remembered(const ph_master *m) {
    const ph_anderson *a = m->memory;
    return 2 + m->nxi + m->nnz + 2 * a->most * m->nxi;
}

static void save(const ph_master *m, double *to) {
    const ph_anderson *a = m->memory;
    const int n = m->nxi;
    double *X = to + 2 + n + m->nnz, *F = X + a->most * n;
    ph_clear(to, remembered(m));
    to[0] = a->begun;
    to[1] = a->count;
    memcpy(to + 2, a->size, bytes(n));
    memcpy(to + 2 + n, m->a, bytes(a->begun ? m->nnz : 0));
    for (int j = 0; j < a->count; j++) {
        memcpy(X + (ptrdiff_t)j * n, row(a, a->X, j, n), bytes(n));
        memcpy(F + (ptrdiff_t)j * n, row(a, a->F, j, n), bytes(n));
    }
}

static void load(ph_master *m, const double *from) {
    ph_anderson *a = m->memory;
    const int n = m->nxi, begun = (int)from[0];
    const double *X = from + 2 + n + m->nnz, *F = X + a->most * n;
    a->count = (int)from[1];
    a->newest = 0;
    memcpy(a->size, from + 2, bytes(n));
    memcpy(a->X, X, bytes(a->count * n));
    memcpy(a->F, F, bytes(a->count * n));
    memcpy(m->a, from + 2 + n, bytes(begun ? m->nnz : 0));
    a->begun = begun && ph_matrix_factor(m) == PH_OK;
}

static int sound(const ph_master *m, const double *from) {
    const ph_anderson *a = m->memory;
    for (int i = 0; i < m->nxi; i++)
        if (!(from[2 + i] > 0.0))
            return 0;
    return ph_counted(from[0], 1) && ph_counted(from[1], a->most);
}

const ph_solver *ph_solver_anderson(void) {
    static const ph_solver anderson = {
        .start = start,
        .take = ph_trial_take,
        .move = move,
        .again = again,
        .drop = drop,
        .forget = forget,
        .remembered = remembered,
        .save = save,
        .load = load,
        .sound = sound,
    };
    return &anderson;
}
