/* Sparse LU by columns (Gilbert and Peierls, SIAM J. Sci. Stat. Comput. 9, 1988) with fixed column
 * order, threshold pivoting and refactorisation with the pivots of the last full factorisation. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "system.h"

#define PREFER 0.01 /* the planned pivot is taken from this fraction of the column maximum on */
#define GROWTH 1e-3 /* an old pivot is kept down to this fraction */

void ph_lu_take(ph_lu *lu, ph_pool *pool) {
    lu->pivot = ph_take_ints(pool, lu->n);
    lu->where = ph_take_ints(pool, lu->n);
    lu->start = ph_take_ints(pool, lu->n + 1);
    lu->lower = ph_take_ints(pool, lu->n);
    lu->index = ph_take_ints(pool, lu->capacity);
    lu->value = ph_take_reals(pool, lu->capacity);
    lu->inverse = ph_take_reals(pool, lu->n);
    lu->place = ph_take_ints(pool, lu->nnz);
    lu->work = ph_take_reals(pool, lu->n);
    lu->mark = ph_take_ints(pool, lu->n);
    lu->stack = ph_take_ints(pool, lu->n);
    lu->child = ph_take_ints(pool, lu->n);
}

/* Rows reached from column j of A through the columns of L found so far, in elimination order in
 * stack[top..n). During factorisation L is indexed by rows, not by pivot steps. */
static int reach(ph_lu *lu, int j) {
    int n = lu->n, top = n, column = lu->order[j];
    for (int e = lu->colptr[column]; e < lu->colptr[column + 1]; e++) {
        int depth = 0;
        if (lu->mark[lu->rowind[e]] == j)
            continue;
        /* The path of the search grows from the bottom of the stack, the result from its top. */
        lu->stack[0] = lu->rowind[e];
        while (depth >= 0) {
            int row = lu->stack[depth], k = lu->where[row], q, end;
            if (lu->mark[row] != j) {
                lu->mark[row] = j;
                lu->child[depth] = k < 0 ? 0 : lu->lower[k];
            }
            end = k < 0 ? 0 : lu->start[k + 1];
            for (q = lu->child[depth]; q < end; q++)
                if (lu->mark[lu->index[q]] != j)
                    break;
            if (q < end) {
                lu->child[depth++] = q + 1;
                lu->stack[depth] = lu->index[q];
            } else {
                lu->stack[--top] = row;
                depth--;
            }
        }
    }
    return top;
}

#ifndef PH_WIDTH
/* Numbers of column j, pattern given; leaves U in value and the rest in work. */
static void eliminate(ph_lu *lu, int j, const double *a) {
    double *x = lu->work;
    int column = lu->order[j];
    for (int e = lu->colptr[column]; e < lu->colptr[column + 1]; e++)
        x[lu->rowind[e]] = a[e];
    for (int q = lu->start[j]; q < lu->lower[j]; q++) {
        int k = lu->index[q], row = lu->pivot[k];
        double xk = x[row];
        x[row] = 0.0;
        lu->value[q] = xk;
        for (int l = lu->lower[k]; l < lu->start[k + 1]; l++)
            x[lu->index[l]] -= lu->value[l] * xk;
    }
}

/* Pivot row among the candidates index[lower[j]..end), or -1. A column that depends on those before it to
 * rounding gets `forced` of its size as pivot, if that is above zero; one of which nothing is left never. */
static int choose(ph_lu *lu, int j, int end, const double *a, double forced) {
    const double *x = lu->work;
    int best = -1, prefer = lu->prefer[j], column = lu->order[j];
    double most = 0.0, original = 0.0;
    for (int e = lu->colptr[column]; e < lu->colptr[column + 1]; e++)
        if (fabs(a[e]) > original)
            original = fabs(a[e]);
    for (int q = lu->lower[j]; q < end; q++) {
        double size = fabs(x[lu->index[q]]);
        if (size > most) {
            most = size;
            best = lu->index[q];
        }
    }
    if (best < 0 || !isfinite(most))
        return -1;
    if (most <= PH_DEPENDENT * DBL_EPSILON * original) {
        if (!(forced > 0.0))
            return -1;
        lu->work[best] = forced * original;
        return best;
    }
    if (prefer >= 0 && lu->where[prefer] < 0 && lu->mark[prefer] == j && fabs(x[prefer]) >= PREFER * most)
        best = prefer;
    return best;
}
#endif

/* Columns of the factors from the first to the last; a = NULL: pattern only, for the pivots given. */
static int full(ph_lu *lu, const ph_real *a, double forced) {
    int n = lu->n, q = 0;
    (void)forced;
    lu->known = lu->ready = lu->filled = 0;
    memset(lu->work, 0, sizeof(ph_real) * (size_t)n);
    for (int i = 0; i < n; i++)
        lu->mark[i] = lu->where[i] = -1;
    for (int j = 0; j < n; j++) {
        int top = reach(lu, j), row, at;
        if (n - top > lu->capacity - q)
            return PH_LU_CAPACITY;
        lu->start[j] = q;
        for (int i = top; i < n; i++)
            if (lu->where[lu->stack[i]] >= 0)
                lu->index[q++] = lu->where[lu->stack[i]];
        lu->lower[j] = q;
        for (int i = top; i < n; i++)
            if (lu->where[lu->stack[i]] < 0)
                lu->index[q++] = lu->stack[i];
        row = lu->pivot[j];
#ifndef PH_WIDTH
        if (a) {
            eliminate(lu, j, a);
            row = choose(lu, j, q, a, forced);
        }
#endif
        for (at = lu->lower[j]; at < q && lu->index[at] != row; at++) {
        }
        lu->failed = lu->order[j];
        if (at == q)
            return PH_SINGULAR;
        lu->index[at] = lu->index[--q];
        lu->where[row] = j;
        lu->pivot[j] = row;
        lu->start[j + 1] = q;
        if (!a)
            continue;
        lu->inverse[j] = 1.0 / lu->work[row];
        lu->work[row] = PH_REAL_SPREAD(0.0);
        for (int l = lu->lower[j]; l < q; l++) {
            lu->value[l] = lu->work[lu->index[l]] * lu->inverse[j];
            lu->work[lu->index[l]] = PH_REAL_SPREAD(0.0);
        }
    }
    for (int j = 0; j < n; j++)
        for (int l = lu->lower[j]; l < lu->start[j + 1]; l++)
            lu->index[l] = lu->where[lu->index[l]];
    for (int e = 0; e < lu->nnz; e++)
        lu->place[e] = lu->where[lu->rowind[e]];
    lu->known = lu->ready = 1;
    lu->filled = a != NULL;
    return PH_OK;
}

#ifndef PH_WIDTH
/* 1 if a search would take the pivot of step j again; others: the largest below it, of equals none is. */
static int is_chosen(const ph_lu *lu, int j, double pivot, double others, const double *a) {
    const int prefer = lu->prefer[j], column = lu->order[j];
    const double most = pivot > others ? pivot : others;
    double original = 0.0;
    for (int e = lu->colptr[column]; e < lu->colptr[column + 1]; e++)
        if (fabs(a[e]) > original)
            original = fabs(a[e]);
    if (!isfinite(most) || most <= PH_DEPENDENT * DBL_EPSILON * original)
        return 0;
    if (prefer == lu->pivot[j])
        return pivot >= PREFER * most;
    if (prefer >= 0 && lu->where[prefer] > j && fabs(lu->work[lu->where[prefer]]) >= PREFER * most)
        return 0;
    return pivot > others;
}
#endif

/* New numbers for the pattern and the pivots there are, the same operations in the same order as the full
 * factorisation; of several runs those are told that refuse it. searched: by these very pivots, those of a
 * search; else as long as none is too small beside its column. */
static inline int repeat(ph_lu *lu, const ph_real *a, int searched) {
    ph_real *restrict x = lu->work;
    ph_real *restrict value = lu->value;
    const int *restrict index = lu->index;
    ph_truth refused = {0};
    (void)searched;
    for (int j = 0; j < lu->n; j++) {
        int column = lu->order[j], lower = lu->lower[j], end = lu->start[j + 1];
        ph_real pivot, most = PH_REAL_SPREAD(0.0);
        for (int e = lu->colptr[column]; e < lu->colptr[column + 1]; e++)
            x[lu->place[e]] = a[e];
        for (int q = lu->start[j]; q < lower; q++) {
            int k = index[q], last = lu->start[k + 1];
            ph_real xk = x[k];
            x[k] = PH_REAL_SPREAD(0.0);
            value[q] = xk;
            for (int l = lu->lower[k]; l < last; l++)
                x[index[l]] -= value[l] * xk;
        }
        pivot = x[j];
#ifndef PH_WIDTH
        if (searched) {
            for (int q = lower; q < end; q++)
                if (fabs(x[index[q]]) > most)
                    most = fabs(x[index[q]]);
            most = is_chosen(lu, j, fabs(pivot), most, a) ? 0.0 : INFINITY;
        }
#endif
        x[j] = PH_REAL_SPREAD(0.0);
        lu->inverse[j] = 1.0 / pivot;
        for (int q = lower; q < end; q++) {
            ph_real xi = x[index[q]];
            x[index[q]] = PH_REAL_SPREAD(0.0);
            value[q] = xi * lu->inverse[j];
            most = PH_REAL_WHERE(PH_REAL_ABS(xi) > most, PH_REAL_ABS(xi), most);
        }
        refused |= PH_NOT(PH_REAL_ABS(pivot) >= GROWTH * most) | (pivot == 0.0);
#ifndef PH_WIDTH
        if (refused)
            return PH_SINGULAR;
#endif
    }
    lu->filled = 1;
    lu->refused = refused;
    return PH_OK;
}

/* Same pattern and pivots. Returns PH_SINGULAR when a pivot has become too small beside its column. */
int ph_lu_refactor(ph_lu *lu, const ph_real *a) {
    return repeat(lu, a, 0);
}

#ifndef PH_WIDTH
/* A search for pivots, to the last bit that of `full`. It mostly finds those of the last factors, which
 * is seen at a fraction of the cost on the way through their pattern. */
static int search(ph_lu *lu, const double *a) {
    if (!lu->known || repeat(lu, a, 1))
        return full(lu, a, 0.0);
    lu->ready = 1;
    return PH_OK;
}

/* Refactorisation, and only if that is refused a new pivot search; count: ph_count counters. */
int ph_lu_factor(ph_lu *lu, const double *a, long long *count) {
    count[PH_FACTORED]++;
    if (lu->ready) {
        if (ph_lu_refactor(lu, a) == PH_OK)
            return PH_OK;
        lu->known = 0; /* a search refuses it too */
    }
    count[PH_PIVOTED]++;
    return search(lu, a);
}

/* Factors where a column that depends on others to rounding gets `forced` of its size as pivot; the next
 * search again. */
int ph_lu_forced(ph_lu *lu, const double *a, double forced) {
    const int status = full(lu, a, forced);
    lu->known = lu->ready = 0;
    return status;
}
#endif

/* Takes over pivot rows (n, pivot[0] = -1: none) and rebuilds their pattern if they are new. */
int ph_lu_adopt(ph_lu *lu, const int *pivot) {
    if (lu->n == 0)
        return PH_OK;
    if (pivot[0] < 0) {
        lu->ready = lu->filled = 0;
        return PH_OK;
    }
    if (lu->ready && memcmp(pivot, lu->pivot, sizeof(int) * (size_t)lu->n) == 0)
        return PH_OK;
    memcpy(lu->pivot, pivot, sizeof(int) * (size_t)lu->n);
    return full(lu, NULL, 0.0);
}

/* x = A^-1 b with the last factor; b and x: n, may not overlap. */
void ph_lu_solve(ph_lu *lu, const ph_real *b, ph_real *x) {
    ph_real *restrict y = lu->work;
    const ph_real *restrict value = lu->value;
    const int *restrict index = lu->index;
    for (int j = 0; j < lu->n; j++)
        y[j] = b[lu->pivot[j]];
    for (int j = 0; j < lu->n; j++) {
        ph_real yj = y[j];
        for (int l = lu->lower[j]; l < lu->start[j + 1]; l++)
            y[index[l]] -= value[l] * yj;
    }
    for (int j = lu->n - 1; j >= 0; j--) {
        ph_real yj = y[j] * lu->inverse[j];
        y[j] = PH_REAL_SPREAD(0.0);
        x[lu->order[j]] = yj;
        for (int q = lu->start[j]; q < lu->lower[j]; q++)
            y[index[q]] -= value[q] * yj;
    }
}

#ifndef PH_WIDTH
/* x = A^-T b with the last factor; b and x: n, may not overlap. */
void ph_lu_solve_transposed(ph_lu *lu, const double *b, double *x) {
    double *restrict y = lu->work;
    const double *restrict value = lu->value;
    const int *restrict index = lu->index;
    for (int j = 0; j < lu->n; j++) {
        double sum = b[lu->order[j]];
        for (int q = lu->start[j]; q < lu->lower[j]; q++)
            sum -= value[q] * y[index[q]];
        y[j] = sum * lu->inverse[j];
    }
    for (int j = lu->n - 1; j >= 0; j--) {
        for (int l = lu->lower[j]; l < lu->start[j + 1]; l++)
            y[j] -= value[l] * y[index[l]];
        x[lu->pivot[j]] = y[j];
    }
    memset(y, 0, sizeof(double) * (size_t)lu->n);
}
#endif
