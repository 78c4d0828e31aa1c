/* Four damped particles, written by hand for this one model: the same method (three Gauss nodes, both
 * constraint levels, Schur stepper), the same predictor and stop, the same ledger. The lower bound for a
 * table-driven runtime. */
#include <math.h>
#include <string.h>

#define P 4  /* particles */
#define D 12 /* degrees of freedom */

typedef double lane __attribute__((vector_size(32), aligned(8)));

static const double mass[P] = {1.0, 3.0, 2.3, 1.7};
static const double stiffness[2] = {50.0, 500.0};
static const int bar[2][2] = {{0, 1}, {2, 3}}, spring[2][2] = {{0, 2}, {1, 3}};

typedef struct particles {
    double q[D], v[D], rest_q[D], rest_v[D];
    double last[D][3], lambda[2][4];
    double stored, lost, worst;
    long long sweeps;
} particles;

static double sum(lane a) {
    return ((a[0] + a[1]) + a[2]) + a[3];
}

static void add(double *to, double *rest, double change) {
    double y = change - *rest, t = *to + y;
    *rest = (t - *to) - y;
    *to = t;
}

static void step(particles *s, const lane *col, const double *b, const lane *multiply, const lane *ahead,
                 int first, double h) {
    const lane nodes = {1.0, 1.0, 1.0, 0.0};
    lane f[D], a[D], n[D], next[D], x[D], lambda[2], g[2][3], schur[2], added[2], stress[2], rate[2];
    double start[2], previous = INFINITY, size = 0.0, stored = 0.0, lost = 0.0;
    for (int d = 0; d < D; d++) {
        n[d] = (lane){0.0};
        f[d] = first ? (lane){s->v[d], s->v[d], s->v[d], s->v[d]}
                     : s->v[d] * ahead[0] + s->last[d][0] * ahead[1] + s->last[d][1] * ahead[2] +
                           s->last[d][2] * ahead[3];
    }
    for (int i = 0; i < 2; i++) {
        start[i] = 0.0;
        for (int j = 0; j < 3; j++) {
            double e = s->q[3 * spring[i][1] + j] - s->q[3 * spring[i][0] + j];
            start[i] += e * e;
        }
        memcpy(&lambda[i], s->lambda[i], sizeof(lane));
    }
    for (int sweep = 1; sweep <= 60; sweep++) {
        lane change = {0.0}, all = {1.0, 1.0, 1.0, 1.0}, e[3], square = {0.0}, v[D];
        double update;
        for (int d = 0; d < D; d++) {
            x[d] = s->q[d] + col[0] * f[d][0] + col[1] * f[d][1] + col[2] * f[d][2];
            v[d] = f[d] - n[d];
            a[d] = n[d] = (lane){0.0};
        }
        for (int i = 0; i < 2; i++) {
            const int p = 3 * bar[i][0], q = 3 * bar[i][1];
            const lane mu = lambda[i][3] * nodes;
            for (int j = 0; j < 3; j++) {
                g[i][j] = x[q + j] - x[p + j];
                lane pull = g[i][j] * lambda[i] + (v[q + j] - v[p + j]) * mu, shift = g[i][j] * mu;
                a[q + j] -= pull, a[p + j] += pull, n[q + j] += shift, n[p + j] -= shift;
            }
        }
        for (int i = 0; i < 2; i++) {
            const int p = 3 * spring[i][0], q = 3 * spring[i][1];
            lane r = {0.0}, c;
            for (int j = 0; j < 3; j++) {
                e[j] = 2.0 * (x[q + j] - x[p + j]);
                r += e[j] * (f[q + j] - f[p + j]);
            }
            c = start[i] + col[0] * r[0] + col[1] * r[1] + col[2] * r[2];
            rate[i] = r;
            stress[i] = stiffness[i] * (c - 1.0);
            for (int j = 0; j < 3; j++)
                a[q + j] -= e[j] * stress[i], a[p + j] += e[j] * stress[i];
        }
        for (int j = 0; j < 3; j++)
            square += (x[6 + j] - x[3 + j]) * (x[6 + j] - x[3 + j]);
        for (int j = 0; j < 3; j++) {
            lane drag = (1.0 + 0.5 * square) * (f[6 + j] - f[3 + j]);
            a[6 + j] -= drag, a[3 + j] += drag;
        }
        for (int d = 0; d < D; d++) {
            a[d] = a[d] / mass[d / 3], n[d] = n[d] / mass[d / 3];
            next[d] = s->v[d] + n[d] + col[0] * a[d][0] + col[1] * a[d][1] + col[2] * a[d][2];
        }
        for (int i = 0; i < 2; i++) {
            const int p = 3 * bar[i][0], q = 3 * bar[i][1];
            const double wp = 1.0 / mass[bar[i][0]], wq = 1.0 / mass[bar[i][1]];
            lane sigma = {0.0};
            if (sweep == 1)
                schur[i] = 1.0 / ((wp + wq) * (g[i][0] * g[i][0] + g[i][1] * g[i][1] + g[i][2] * g[i][2]));
            for (int j = 0; j < 3; j++)
                sigma += g[i][j] * (next[q + j] - next[p + j]);
            sigma *= schur[i];
            for (int j = 0; j < 3; j++)
                next[q + j] -= wq * (g[i][j] * sigma), next[p + j] += wp * (g[i][j] * sigma);
            added[i] = multiply[0] * sigma[0] + multiply[1] * sigma[1] + multiply[2] * sigma[2] +
                       multiply[3] * sigma[3];
            lambda[i] += added[i];
        }
        for (int d = 0; d < D; d++) {
            change += (next[d] - f[d]) * (next[d] - f[d]);
            all += next[d] * next[d];
            f[d] = next[d];
        }
        s->sweeps++;
        update = sum(change);
        if (sweep == 1)
            size = sum(all);
        else if (update < 0.25 * previous ? update * update <= 1e-30 * size * previous
                                          : update <= 1e-20 * size)
            break;
        previous = update;
    }
    for (int i = 0; i < 2; i++) {
        memcpy(s->lambda[i], &lambda[i], sizeof(lane));
        for (int j = 0; j < 3; j++) {
            a[3 * bar[i][1] + j] -= g[i][j] * added[i] / mass[bar[i][1]];
            a[3 * bar[i][0] + j] += g[i][j] * added[i] / mass[bar[i][0]];
        }
        for (int j = 0; j < 3; j++)
            stored += h * b[j] * rate[i][j] * stress[i][j];
    }
    for (int j = 0; j < 3; j++) {
        lane square = {0.0}, w = {0.0};
        for (int l = 0; l < 3; l++) {
            square += (x[6 + l] - x[3 + l]) * (x[6 + l] - x[3 + l]);
            w += (f[6 + l] - f[3 + l]) * (f[6 + l] - f[3 + l]);
        }
        lost += h * b[j] * (1.0 + 0.5 * square[j]) * w[j];
    }
    for (int d = 0; d < D; d++) {
        double dq = 0.0, dv = 0.0;
        for (int j = 0; j < 3; j++) {
            s->last[d][j] = f[d][j];
            dq += h * b[j] * f[d][j];
            dv += h * b[j] * a[d][j];
        }
        stored += mass[d / 3] * (s->v[d] + 0.5 * dv) * dv;
        add(&s->q[d], &s->rest_q[d], dq);
        add(&s->v[d], &s->rest_v[d], dv);
    }
    s->stored += stored;
    s->lost += lost;
    s->worst = fmax(s->worst, fabs(stored + lost));
}

/* n steps of length h; extended (4 x 3: A, then b), multiplier and ahead (4 x 4), all row-major; state: q, v.
 * Returns the largest residual of the energy balance of a step; sweeps: their number. */
__attribute__((visibility("default"))) double hand_written(double h, int n, const double *extended,
                                                           const double *multiplier, const double *ahead,
                                                           double *state, long long *sweeps) {
    particles s;
    lane col[3], multiply[4], weights[4];
    memset(&s, 0, sizeof(s));
    memcpy(s.q, state, sizeof(s.q));
    memcpy(s.v, state + D, sizeof(s.v));
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 3; j++)
            col[j][i] = h * extended[3 * i + j];
        for (int j = 0; j < 4; j++) {
            multiply[j][i] = multiplier[4 * i + j] / (i < 3 ? h : 1.0);
            weights[j][i] = ahead[4 * i + j];
        }
    }
    for (int i = 0; i < n; i++)
        step(&s, col, extended + 9, multiply, weights, i == 0, h);
    memcpy(state, s.q, sizeof(s.q));
    memcpy(state + D, s.v, sizeof(s.v));
    *sweeps = s.sweeps;
    return s.worst;
}
