/* Zeros of a guard within a step, from Bernstein coefficients, which are halved until one change of sign is
 * left (Lane, Riesenfeld, BIT 21, 1981). */
#include <math.h>
#include <string.h>

#include "events.h"

#define DEPTH 40
#define BISECTIONS 52
#define ASIDE 0.4375

/* Coefficients on [0, t] and [t, 1]. */
static void part(const double *b, int n, double t, double *left, double *right) {
    double c[PH_MOST_POINTS];
    memcpy(c, b, sizeof(double) * (size_t)(n + 1));
    for (int i = 0; i <= n; i++) {
        left[i] = c[0];
        right[n - i] = c[n - i];
        for (int j = 0; j < n - i; j++)
            c[j] += t * (c[j + 1] - c[j]);
    }
}

double ph_bernstein(const double *b, int n, double t) {
    double c[PH_MOST_POINTS];
    memcpy(c, b, sizeof(double) * (size_t)(n + 1));
    for (int m = n; m > 0; m--)
        for (int j = 0; j < m; j++)
            c[j] += t * (c[j + 1] - c[j]);
    return c[0];
}

double ph_bernstein_slope(const double *b, int n, double t, int from_zero) {
    double c[PH_MOST_POINTS] = {0.0}, rate;
    for (int j = 0; j < n; j++)
        c[j] = (b[j + 1] - b[j]) * n;
    rate = ph_bernstein(c, n > 0 ? n - 1 : 0, t);
    return from_zero ? ph_bernstein(b, n, t) + t * rate : rate;
}

/* An interval with the first crossing in the direction and no other. */
static int isolated(const double *b, int n, int direction, double *low, double *high, int depth) {
    double left[PH_MOST_POINTS], right[PH_MOST_POINTS], t = 0.5, middle, ends[2];
    int changes = 0, sign = 0;
    for (int i = 0; i <= n; i++) {
        const int now = (b[i] > 0.0) - (b[i] < 0.0);
        changes += now && sign && now != sign;
        sign = now ? now : sign;
    }
    if (changes == 0 || depth == DEPTH)
        return 0;
    if (changes == 1 && b[0] != 0.0 && b[n] != 0.0)
        return direction == 0 || direction == sign;
    part(b, n, t, left, right);
    if (left[n] == 0.0)
        part(b, n, t = ASIDE, left, right);
    middle = *low + t * (*high - *low);
    ends[0] = *low;
    ends[1] = middle;
    if (isolated(left, n, direction, &ends[0], &ends[1], depth + 1)) {
        *low = ends[0];
        *high = ends[1];
        return 1;
    }
    *low = middle;
    return isolated(right, n, direction, low, high, depth + 1);
}

int ph_turns(double start, double end, double slope_start, double slope_end, double *tau) {
    const double side = start > 0.0 ? 1.0 : -1.0;
    const double b[4] = {start, start + slope_start / 3, end - slope_end / 3, end};
    const double rate[3] = {b[1] - b[0], b[2] - b[1], b[3] - b[2]};
    double least, chord;
    ph_crossing at;
    if (start == 0.0 || fabs(slope_start) * PH_TURN_REACH < fabs(start) ||
        !(end * side > 0.0 && slope_start * side < 0.0 && slope_end * side > 0.0) ||
        !ph_first_crossing(rate, 2, 0, 0, &at))
        return 0;
    *tau = at.tau;
    least = ph_bernstein(b, 3, at.tau);
    chord = start + at.tau * (end - start);
    return least * side <= PH_TURN_NEAR * fabs(chord - least);
}

double ph_vertex(const double left[2], const double middle[2], const double right[2]) {
    const double before = (middle[1] - left[1]) / (middle[0] - left[0]);
    const double after = (right[1] - middle[1]) / (right[0] - middle[0]);
    const double curved = (after - before) / (right[0] - left[0]);
    return curved > 0.0 ? (left[0] + middle[0] - before / curved) / 2 : middle[0];
}

int ph_first_crossing(const double *b, int n, int direction, int from_zero, ph_crossing *at) {
    double low = 0.0, high = 1.0, sign;
    if (!isolated(b, n, direction, &low, &high, 0))
        return 0;
    sign = ph_bernstein(b, n, low);
    for (int i = 0; i < BISECTIONS; i++) {
        const double middle = (low + high) / 2;
        if (ph_bernstein(b, n, middle) * sign > 0.0)
            low = middle;
        else
            high = middle;
    }
    at->tau = high;
    at->slope = ph_bernstein_slope(b, n, high, from_zero);
    return 1;
}
