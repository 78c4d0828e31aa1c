/* Steps: solve, book the ledger, update the state; halve a step that does not solve. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "system.h"

/* x += change, compensated. */
static void add_all(double *restrict x, double *restrict rest, const double *restrict change, int n) {
    for (int i = 0; i < n; i++) {
        double term = change[i] - rest[i], sum = x[i] + term;
        rest[i] = (sum - x[i]) - term;
        x[i] = sum;
    }
}

/* x += update of the plan at the unknowns. */
static void move(ph_instance *in) {
    const ph_plan *p = in->step.plan;
    for (int u = 0; u < p->nupdate; u++) {
        const int first = p->update_x[u], n = p->update_n[u];
        double *restrict change = in->change;
        for (int i = 0; i < n; i++)
            change[i] = 0.0;
        for (int l = p->update_ptr[u]; l < p->update_ptr[u + 1]; l++) {
            const double *restrict w = in->step.y + p->update_w[l];
            const double c = p->update_c[l];
            for (int i = 0; i < n; i++)
                change[i] += c * w[i];
        }
        add_all(in->table + first, in->rest + first, change, n);
    }
}

static int within(const double *restrict values, int n) {
    int beyond = 0;
    for (int i = 0; i < n; i++)
        beyond |= !(fabs(values[i]) <= PH_LARGEST);
    return !beyond;
}

/* Energies of a solved part of length h: in->stored, moved, lost, numerical, energies and means. Refused if
 * they, the states, or the sums they go into are so large that these may not be finite. Nothing of the state
 * changes. */
static int weigh(ph_instance *in, double h) {
    ph_system *s = &in->step;
    const ph_plan *p = s->plan;
    const double *sum = in->table + in->offset[PH_ENERGY];
    double most = 0.0; /* sum of sizes: not a number if a term is none */
    int fits = within(in->table, p->nx);
    if (s->resting) {
        memcpy(in->unspread, s->y, sizeof(double) * (size_t)p->nw);
        ph_rest_spread(s);
    }
    ph_eval_ledger(s, in->stored, in->moved, in->lost, in->numerical);
    for (int j = 0; j < p->nq; j++) {
        double y = 0.0, power = 0.0;
        for (int i = 0; i < p->k; i++) {
            double part = p->weights[i] * s->r[p->nw + i * p->nq + j];
            y += part;
            power += part * s->y[p->pair_src[i * p->nq + j]];
        }
        in->means[j] = y;
        in->energies[j] = h * power;
        fits &= fabs(in->energies[j]) + fabs(sum[j]) <= PH_LARGEST;
    }
    for (int l = 0; l < p->nwork; l++)
        most += fabs(s->r[p->work_row[l]]);
    sum += p->nq;
    for (int c = 0; c < p->ncomp; c++) {
        const double *cumulative = sum + c;
        in->lost[c] *= h;
        most += (in->moved[c] + fabs(in->lost[c])) + (fabs(in->numerical[c]) + fabs(cumulative[0])) +
                (fabs(cumulative[p->ncomp]) + fabs(cumulative[2 * p->ncomp]));
    }
    return fits && most <= PH_LARGEST ? PH_OK : PH_NOT_FINITE;
}

/* Ledger, means and state after a converged and weighed solve of the part [from, from + weight] of the
 * communication step. */
static void accept(ph_instance *in, double h, double from, double weight) {
    ph_system *s = &in->step;
    const ph_plan *p = s->plan;
    double *a = in->table + in->offset[PH_A], *mean = in->table + in->offset[PH_Y_STEP];
    for (int c = 0; c < p->ncomp; c++) {
        in->row[PH_ROW_STORED][c] += in->stored[c];
        in->row[PH_ROW_DISSIPATED][c] += in->lost[c];
        in->row[PH_ROW_NUMERICAL][c] += in->numerical[c];
        in->row[PH_ROW_MOVED][c] += in->moved[c];
    }
    for (int j = 0; j < p->nq; j++) {
        mean[j] += weight * in->means[j];
        in->row[PH_ROW_PAIRS][j] += in->energies[j];
        in->row[PH_ROW_SUPPLIED][p->pair_owner[j]] += in->energies[j];
    }
    for (int l = 0; l < p->nwork; l++) {
        double energy = s->r[p->work_row[l]];
        in->row[PH_ROW_PAIRS][p->work_pair[l]] += energy;
        in->row[PH_ROW_SUPPLIED][p->pair_owner[p->work_pair[l]]] += energy;
    }
    for (int l = 0; l < p->nmean && p->carries; l++)
        a[p->mean_a[l]] = 0.0;
    for (int l = 0; l < p->nmean; l++) {
        double part = (p->carries ? 1.0 : weight) * p->mean_c[l] * s->y[p->mean_w[l]];
        a[p->mean_a[l]] += p->mean_pow[l] < 0 ? part / h : part;
    }
    ph_book_nodes(in, from, weight);
    move(in);
    in->head->parts++;
    memcpy(s->last, s->resting ? in->unspread : s->y, sizeof(double) * (size_t)p->nw);
    *s->last_h = h;
    if (s->resting)
        ph_rest_exchange(in, in->table[p->nx] + h);
}

/* The Schur stepper where the model has one and it leaves out the constraints that rest; else, or where it
 * does not converge, Newton's method. */
static int solve(ph_instance *in, double h) {
    ph_system *s = &in->step;
    if (!in->schur || !in->planned || ph_schur_solver.solve(in->schur, s, h) != PH_OK)
        return ph_solve(s, h);
    ph_eval_h(s, h);
    if (!s->resting) {
        ph_eval_late(s);
        return PH_OK;
    }
    ph_eval(s, 0, 0); /* what those that rest miss */
    return PH_OK;
}

/* Solves the part [from, from + weight] of the communication step [t, t+h]; of the state only the time and,
 * if it succeeds, the constraints that rest change. */
static int try_part(ph_instance *in, double t, double h, double from, double weight) {
    ph_system *s = &in->step;
    int status, called = 0;
    in->table[s->plan->nx] = t + h * from;
    ph_resample(in, from, weight, s->y + s->plan->nw);
    in->count[PH_SOLVES]++;
    for (;;) {
        status = solve(in, h * weight);
        if (status || !s->resting || !ph_rest_wake(in))
            break;
        called = 1;
    }
    if (status)
        ph_explain(s, status, &in->report);
    else if (weigh(in, h * weight))
        in->report = (ph_report){.status = status = PH_NOT_FINITE, .row = -1, .column = -1};
    if (status) {
        in->report.spent = (int)(in->count[PH_ITERATIONS] - in->begun);
        in->report.time = t + h * from;
        in->report.h = h * weight;
    }
    if (called)
        ph_rest_settle(in, t + h * (from + weight), status == PH_OK);
    return status;
}

/* Internal step i of n; on failure it is halved, and its halves again, down to PH_DEPTH. The place is
 * counted in smallest substeps; its alignment tells how long the next substep may be. refused: the step as a
 * whole has been tried. */
static int walk(ph_instance *in, double t, double h, int i, int n, int refused) {
    const int all = PH_SMALLEST;
    for (int at = 0, length; at < all; at += length) {
        for (length = refused && at == 0 ? all / 2 : all; at % length; length /= 2) {
        }
        for (;; length /= 2) {
            double from = (i + (double)at / all) / n, weight = (double)length / all / n;
            int status = try_part(in, t, h, from, weight);
            if (status == PH_OK) {
                accept(in, h * weight, from, weight);
                if (length < all)
                    ph_part_ends(in, i, at + length);
                break;
            }
            if (length == 1 || in->count[PH_ITERATIONS] >= in->step.most)
                return status;
            in->count[PH_SUBSTEPS]++;
        }
    }
    return PH_OK;
}

/* An internal step begins: it may take so many iterations, `all` those of the communication step. */
static void allow(ph_instance *in, long long all) {
    in->begun = in->count[PH_ITERATIONS];
    in->step.most = in->begun + PH_MOST_ITERATIONS < all ? in->begun + PH_MOST_ITERATIONS : all;
}

/* The ledger of the communication step starts at zero. */
static void clear_rows(ph_instance *in) {
    const ph_plan *p = in->step.plan;
    for (int i = 0; i < PH_ROW_PAIRS; i++)
        ph_clear(in->row[i], p->ncomp);
    ph_clear(in->row[PH_ROW_PAIRS], p->nq);
}

/* So do its other sums. */
static void begin(ph_instance *in, double h) {
    const ph_plan *p = in->step.plan;
    double *a = in->table + in->offset[PH_A];
    memcpy(in->x_old, in->table, sizeof(double) * (size_t)(p->nx + 1 + p->na));
    if (p->nu > 0)
        memcpy(in->u_old, in->u, sizeof(double) * (size_t)(p->nu * p->k));
    clear_rows(in);
    ph_clear(in->table + in->offset[PH_Y_STEP], p->nq);
    ph_clear(in->y_node, p->k > 1 ? p->nq * p->k : 0);
    for (int l = 0; l < p->nmean && !p->carries; l++)
        a[p->mean_a[l]] = 0.0;
    in->head->parts = 0;
    in->head->step_h = h;
}

/* Books the step into the cumulative sums. */
static void finish(ph_instance *in, double t) {
    const ph_plan *p = in->step.plan;
    double *energy = in->table + in->offset[PH_ENERGY], *supplied = in->table + in->offset[PH_SUPPLIED];
    double *dissipated = in->table + in->offset[PH_DISSIPATED];
    double *residual = in->table + in->offset[PH_RESIDUAL], *rest = in->table_rest;
    for (int j = 0; j < p->nq; j++)
        ph_add(&energy[j], rest++, in->row[PH_ROW_PAIRS][j]);
    for (int c = 0; c < p->ncomp; c++) {
        double stored = in->row[PH_ROW_STORED][c], lost = in->row[PH_ROW_DISSIPATED][c];
        double given = in->row[PH_ROW_SUPPLIED][c];
        ph_add(&supplied[c], rest++, given);
        ph_add(&dissipated[c], rest++, lost);
        ph_add(&residual[c], rest++, stored + lost + in->row[PH_ROW_NUMERICAL][c] - given);
    }
    if (in->step.lu.ready)
        memcpy(in->step.pivot, in->step.lu.pivot, sizeof(int) * (size_t)p->nw);
    in->table[p->nx] = t;
    in->head->theta = 1.0;
    in->head->dirty = 1;
    in->count[PH_STEPS]++;
}

/* A step of length zero is the identity: the state stays to the last bit, no energy moves, and the means of
 * the step are the limits for h -> 0, the values at the instant. */
static int stay(ph_instance *in, double t) {
    int status;
    in->table[in->step.plan->nx] = t;
    in->head->dirty = 1;
    status = ph_refresh(in);
    if (status)
        return status;
    begin(in, 0.0);
    ph_take_instant(in, !in->step.plan->carries);
    in->count[PH_STEPS]++;
    return PH_OK;
}

int ph_is_sliver(const ph_instance *in, double t, double h) {
    return fabs(h) <= PH_SLIVER_CLOCK * DBL_EPSILON * fabs(t) ||
           fabs(h) <= PH_SLIVER_STEP * fabs(*in->step.last_h);
}

int ph_skip(ph_instance *in, double t) {
    if (!isfinite(t))
        return PH_ARGUMENT;
    in->table[in->step.plan->nx] = t;
    clear_rows(in);
    in->head->dirty = 1;
    in->count[PH_STEPS]++;
    return PH_OK;
}

/* The step as one part, which is what nearly all steps are: solved before anything of the state changes, it
 * needs no copy to come back to. */
static int whole(ph_instance *in, double t, double h) {
    double *time = in->table + in->step.plan->nx, before = *time;
    int status = try_part(in, t, h, 0.0, 1.0);
    *time = before;
    if (status)
        return status;
    begin(in, h);
    *time = t;
    accept(in, h, 0.0, 1.0);
    finish(in, t + h);
    return PH_OK;
}

static int advance(ph_instance *in, double t, double h, int n) {
    const long long all = in->count[PH_ITERATIONS] + PH_MOST_ITERATIONS + (long long)n * PH_MORE_ITERATIONS;
    int refused = 0;
    if (!isfinite(t + h) || n < 1)
        return PH_ARGUMENT;
    if (in->head->placed)
        ph_rest_choose(in);
    allow(in, all);
    if (n == 1 && h != 0.0) {
        if (whole(in, t, h) == PH_OK)
            return PH_OK;
        in->count[PH_SUBSTEPS]++;
        refused = 1;
    }
    ph_save(in, in->backup);
    if (h == 0.0) {
        int status = stay(in, t);
        if (status == PH_OK)
            return status;
        in->count[PH_FAILED]++;
        ph_load(in, in->backup);
        return status;
    }
    begin(in, h);
    ph_parts_begin(in, n);
    for (int i = 0; i < n; i++) {
        int status;
        if (i > 0)
            allow(in, all);
        status = walk(in, t, h, i, n, refused);
        if (status == PH_OK)
            continue;
        in->count[PH_FAILED]++;
        in->report.solved = i;
        ph_load(in, in->backup);
        return status;
    }
    finish(in, t + h);
    return PH_OK;
}

int ph_step_parts(ph_instance *in, double t, double h, int n) {
    if (isfinite(t + h) && n >= 1 && h != 0.0 && ph_is_sliver(in, t, h))
        return ph_skip(in, t + h);
    return advance(in, t, h, n);
}

int ph_step_exactly(ph_instance *in, double t, double h, int n) {
    return advance(in, t, h, n);
}

int ph_step(ph_instance *in, double t, double h) {
    return ph_step_parts(in, t, h, 1);
}

static void put(const ph_column *column, int row, const double *from, int n) {
    if (column->data && n > 0)
        memcpy(column->data + row * column->stride, from, sizeof(double) * (size_t)n);
}

static void write_row(ph_instance *in, const ph_record *r, int row) {
    const ph_plan *p = in->step.plan;
    const int *offset = in->offset;
    put(&r->signals, row, in->table, offset[PH_NBLOCK]);
    put(&r->x, row, in->table, p->nx);
    put(&r->a, row, in->table + offset[PH_A], p->na);
    put(&r->y_step, row, in->table + offset[PH_Y_STEP], p->nq);
    put(&r->pairs, row, in->row[PH_ROW_PAIRS], p->nq);
    put(&r->stored, row, in->row[PH_ROW_STORED], p->ncomp);
    put(&r->dissipated, row, in->row[PH_ROW_DISSIPATED], p->ncomp);
    put(&r->supplied, row, in->row[PH_ROW_SUPPLIED], p->ncomp);
    put(&r->numerical, row, in->row[PH_ROW_NUMERICAL], p->ncomp);
    put(&r->moved, row, in->row[PH_ROW_MOVED], p->ncomp);
    put(&r->unknowns, row, in->step.last, p->nw);
    put(&r->energy, row, in->table + offset[PH_H], p->ncomp);
}

int ph_run(ph_instance *in, double t0, double h, int n, const ph_record *record, int *done) {
    const ph_record nothing = {.parts = 1};
    const ph_record *r = record ? record : &nothing;
    const int refresh = r->signals.data || r->energy.data;
    for (*done = 0; *done < n; ++*done) {
        double before[2] = {(double)in->count[PH_ITERATIONS], (double)in->count[PH_SOLVES]}, spent[2];
        int status;
        if (r->input) {
            status = ph_set_input(in, r->input + *done * r->input_stride);
            if (status)
                return status;
        }
        if (refresh)
            ph_save(in, in->backup);
        status = ph_step_parts(in, t0 + (double)(r->first + *done) * h, h, r->parts);
        if (status)
            return status;
        spent[0] = (double)in->count[PH_ITERATIONS] - before[0];
        spent[1] = (double)in->count[PH_SOLVES] - before[1];
        put(&r->counts, *done, spent, 2);
        if (refresh)
            status = ph_refresh(in);
        if (status) { /* a step whose end values are asked for and do not exist is not taken */
            ph_load(in, in->backup);
            in->count[PH_STEPS]--;
            in->count[PH_FAILED]++;
            return status;
        }
        write_row(in, r, *done);
    }
    return PH_OK;
}
