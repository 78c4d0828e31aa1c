/* Compensated sums of tables and largest values so far, row after row: the same bits as those of sums.py,
 * which makes them array by array. */
#include "sums.h"

static double rounded_off(double before, double x, double after) {
    const double error = ph_rounded_off(before, x, after);
    return isfinite(error) ? error : 0.0;
}

/* Column j of x [n*m] to the sum high[j] + low[j]; running [n*m] or NULL: the sums up to each row. */
PH_API void ph_sums_down(ptrdiff_t n, ptrdiff_t m, const double *x, double *high, double *low,
                         double *running) {
    for (ptrdiff_t i = 0; i < n; i++, x += m) {
        for (ptrdiff_t j = 0; j < m; j++) {
            const double before = high[j], after = before + x[j];
            low[j] += rounded_off(before, x[j], after);
            high[j] = after;
        }
        for (ptrdiff_t j = 0; running && j < m; j++)
            running[i * m + j] = high[j] + low[j];
    }
}

/* Sums over groups of columns of each row of x [n*m]: group g has the columns at[end[g-1]..end[g]-1]; out
 * [n*groups]. */
PH_API void ph_sums_across(ptrdiff_t n, ptrdiff_t m, const double *x, ptrdiff_t groups, const ptrdiff_t *end,
                           const ptrdiff_t *at, double *out) {
    for (ptrdiff_t i = 0; i < n; i++, x += m) {
        for (ptrdiff_t g = 0, j = 0; g < groups; g++) {
            double high = 0.0, low = 0.0;
            for (; j < end[g]; j++) {
                const double before = high;
                high += x[at[j]];
                low += rounded_off(before, x[at[j]], high);
            }
            *out++ = high + low;
        }
    }
}

/* The largest of most[j] and column j of x [n*m] up to each row, in place; numbers only, no NaN. */
PH_API void ph_most_down(ptrdiff_t n, ptrdiff_t m, double *x, const double *most) {
    for (ptrdiff_t i = 0; i < n; i++, most = x, x += m) {
        for (ptrdiff_t j = 0; j < m; j++)
            x[j] = x[j] > most[j] ? x[j] : most[j];
    }
}
