/* Small dense systems with complete pivoting. */
#include <math.h>
#include <string.h>

#include "work.h"

static void swap(int *list, int i, int j) {
    const int kept = list[i];
    list[i] = list[j];
    list[j] = kept;
}

/* A = L U with rows and columns in the order of the pivots, b with the rows; the rank. */
static int eliminate(int n, double *a, double *b, double least, int *rows, int *columns) {
    for (int i = 0; i < n; i++)
        rows[i] = columns[i] = i;
    for (int k = 0; k < n; k++) {
        int at_row = k, at_column = k;
        double most = 0.0;
        for (int i = k; i < n; i++)
            for (int j = k; j < n; j++)
                if (fabs(a[rows[i] * n + columns[j]]) > most) {
                    most = fabs(a[rows[i] * n + columns[j]]);
                    at_row = i;
                    at_column = j;
                }
        if (!(most > least))
            return k;
        swap(rows, k, at_row);
        swap(columns, k, at_column);
        for (int i = k + 1; i < n; i++) {
            double *row = a + rows[i] * n;
            const double *pivot = a + rows[k] * n, part = row[columns[k]] / pivot[columns[k]];
            if (part == 0.0)
                continue;
            for (int j = k + 1; j < n; j++)
                row[columns[j]] -= part * pivot[columns[j]];
            if (b)
                b[rows[i]] -= part * b[rows[k]];
        }
    }
    return n;
}

int ph_dense_solve(int n, double *a, double *b, double least, double *y, int *rows, int *columns) {
    const int rank = eliminate(n, a, b, least, rows, columns);
    for (int k = n - 1; k >= 0; k--) {
        const double *row = a + rows[k] * n;
        double sum = b[rows[k]];
        y[columns[k]] = 0.0;
        if (k >= rank)
            continue;
        for (int j = k + 1; j < rank; j++)
            sum -= row[columns[j]] * y[columns[j]];
        y[columns[k]] = sum / row[columns[k]];
    }
    return rank;
}

int ph_dense_null(int n, double *a, double least, double *basis, int *rows, int *columns) {
    const int rank = eliminate(n, a, NULL, least, rows, columns);
    for (int d = rank; d < n; d++) {
        double *v = basis + (d - rank) * n;
        memset(v, 0, sizeof(double) * (size_t)n);
        v[columns[d]] = 1.0;
        for (int k = rank - 1; k >= 0; k--) {
            const double *row = a + rows[k] * n;
            double sum = row[columns[d]];
            for (int j = k + 1; j < rank; j++)
                sum += row[columns[j]] * v[columns[j]];
            v[columns[k]] = -sum / row[columns[k]];
        }
    }
    return n - rank;
}
