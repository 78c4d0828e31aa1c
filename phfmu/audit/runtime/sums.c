/* Compensated sums of tables, row after row: the same bits as those of sums.py, which makes them array by
 * array. */
#include <math.h>
#include <stddef.h>

#if defined(_WIN32)
#define PH_API __declspec(dllexport)
#else
#define PH_API __attribute__((visibility("default")))
#endif

/* What the addition after = before + x has rounded off. */
static double rounded_off(double before, double x, double after) {
    const double part = after - before;
    const double error = (before - (after - part)) + (x - part);
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

/* Sum over the columns `at` [c] of each row of x [n*m]; out [n]. */
PH_API void ph_sums_across(ptrdiff_t n, ptrdiff_t m, const double *x, ptrdiff_t c, const ptrdiff_t *at,
                           double *out) {
    for (ptrdiff_t i = 0; i < n; i++, x += m) {
        double high = 0.0, low = 0.0;
        for (ptrdiff_t j = 0; j < c; j++) {
            const double before = high;
            high += x[at[j]];
            low += rounded_off(before, x[at[j]], high);
        }
        out[i] = high + low;
    }
}
