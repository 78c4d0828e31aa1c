/* The ledger of a step: energies of a solved part, the state and the means it leads to, and their sums. */
#include <math.h>
#include <string.h>

#include "judge.h"
#include "system.h"

/* x += change, compensated. */
static void add_all(ph_real *restrict x, ph_real *restrict rest, const ph_real *restrict change, int n) {
    for (int i = 0; i < n; i++) {
        ph_real term = change[i] - rest[i], sum = x[i] + term;
        rest[i] = (sum - x[i]) - term;
        x[i] = sum;
    }
}

/* x += update of the plan at the unknowns. */
static void move(ph_instance *in) {
    const ph_plan *p = in->step.plan;
    for (int u = 0; u < p->nupdate; u++) {
        const int first = p->update_x[u], n = p->update_n[u];
        ph_real *restrict change = in->change;
        for (int i = 0; i < n; i++)
            change[i] = PH_REAL_SPREAD(0.0);
        for (int l = p->update_ptr[u]; l < p->update_ptr[u + 1]; l++) {
            const ph_real *restrict w = in->step.y + p->update_w[l];
            const double c = p->update_c[l];
            for (int i = 0; i < n; i++)
                change[i] += c * w[i];
        }
        add_all(in->table + first, in->rest + first, change, n);
    }
}

static ph_truth beyond(const ph_real *restrict values, int n) {
    ph_truth found = {0};
    for (int i = 0; i < n; i++)
        found |= PH_NOT(PH_REAL_ABS(values[i]) <= PH_LARGEST);
    return found;
}

/* The energies supplied to the components of a weighed part, and those in play in them. */
static void take_in_play(ph_instance *in) {
    const ph_system *s = &in->step;
    const ph_plan *p = s->plan;
    ph_clear(in->given, p->ncomp);
    ph_clear(in->in_play, p->ncomp);
    for (int j = 0; j < p->nq; j++) {
        in->given[p->pair_owner[j]] += in->energies[j];
        in->in_play[p->pair_owner[j]] += PH_REAL_ABS(in->energies[j]);
    }
    for (int l = 0; l < p->nwork; l++) {
        const int owner = p->pair_owner[p->work_pair[l]];
        in->given[owner] += s->r[p->work_row[l]];
        in->in_play[owner] += PH_REAL_ABS(s->r[p->work_row[l]]);
    }
    for (int c = 0; c < p->ncomp; c++)
        in->in_play[c] = ph_in_play(in->moved[c], in->stored[c], in->given[c], in->lost[c], in->numerical[c],
                                    in->in_play[c]);
}

/* True if the weighed part closes by the rule of the ledger, as far as the instance knows the run: not how
 * large H is, whose rounding would excuse more where hardly anything has moved. */
ph_truth ph_closes(const ph_instance *in) {
    ph_truth closes = PH_TRUE;
    for (int c = 0; c < in->step.plan->ncomp; c++) {
        const ph_real missed = in->stored[c] + in->lost[c] + in->numerical[c] - in->given[c];
        const ph_real reach = ph_most(in->reach[c], in->in_play[c]);
        closes &= PH_REAL_ABS(missed) <= ph_allowed(PH_RTOL, in->in_play[c], reach, PH_REAL_SPREAD(0.0));
    }
    return closes;
}

/* Energies of a solved part of length h: in->stored, moved, lost, numerical, energies and means. True if it
 * is refused, as they, the states, or the sums they go into are so large that these may not be finite.
 * Nothing of the state changes. */
ph_truth ph_weigh(ph_instance *in, double h) {
    ph_system *s = &in->step;
    const ph_plan *p = s->plan;
    const ph_real *sum = in->table + in->offset[PH_ENERGY];
    ph_real most = PH_REAL_SPREAD(0.0); /* sum of sizes: not a number if a term is none */
    ph_truth refused = beyond(in->table, p->nx);
#ifndef PH_WIDTH
    if (s->resting) {
        memcpy(in->unspread, s->y, sizeof(ph_real) * (size_t)p->nw);
        ph_rest_spread_step(in);
    }
#endif
    ph_eval_ledger(s, in->stored, in->moved, in->lost, in->numerical);
    for (int j = 0; j < p->nq; j++) {
        ph_real y = PH_REAL_SPREAD(0.0), power = y;
        for (int i = 0; i < p->k; i++) {
            ph_real part = p->weights[i] * s->r[p->nw + i * p->nq + j];
            y += part;
            power += part * s->y[p->pair_src[i * p->nq + j]];
        }
        in->means[j] = y;
        in->energies[j] = h * power;
        refused |= PH_NOT(PH_REAL_ABS(in->energies[j]) + PH_REAL_ABS(sum[j]) <= PH_LARGEST);
    }
    for (int l = 0; l < p->nwork; l++)
        most += PH_REAL_ABS(s->r[p->work_row[l]]);
    sum += p->nq;
    for (int c = 0; c < p->ncomp; c++) {
        const ph_real *cumulative = sum + c;
        in->lost[c] *= h;
        most += (in->moved[c] + PH_REAL_ABS(in->lost[c])) +
                (PH_REAL_ABS(in->numerical[c]) + PH_REAL_ABS(cumulative[0])) +
                (PH_REAL_ABS(cumulative[p->ncomp]) + PH_REAL_ABS(cumulative[2 * p->ncomp]));
    }
    if (p->schur)
        take_in_play(in);
    return refused | PH_NOT(most <= PH_LARGEST);
}

/* Ledger, means and state after a converged and weighed solve of the part [from, from + weight] of the
 * communication step. */
void ph_accept(ph_instance *in, double h, double from, double weight) {
    ph_system *s = &in->step;
    const ph_plan *p = s->plan;
    ph_real *a = in->table + in->offset[PH_A], *mean = in->table + in->offset[PH_Y_STEP];
    if (in->tape)
        in->tape->take(in->tape, in, h);
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
        ph_real energy = s->r[p->work_row[l]];
        in->row[PH_ROW_PAIRS][p->work_pair[l]] += energy;
        in->row[PH_ROW_SUPPLIED][p->pair_owner[p->work_pair[l]]] += energy;
    }
    for (int c = 0; c < p->ncomp && p->schur; c++)
        in->reach[c] = ph_most(in->reach[c], in->in_play[c]);
    for (int l = 0; l < p->nmean && p->carries; l++)
        a[p->mean_a[l]] = PH_REAL_SPREAD(0.0);
    for (int l = 0; l < p->nmean; l++) {
        ph_real part = (p->carries ? 1.0 : weight) * p->mean_c[l] * s->y[p->mean_w[l]];
        a[p->mean_a[l]] += p->mean_pow[l] < 0 ? part / h : part;
    }
    ph_book_nodes(in, from, weight);
    move(in);
    in->head->parts++;
    memcpy(s->last, s->resting ? in->unspread : s->y, sizeof(ph_real) * (size_t)p->nw);
    *s->last_h = h;
#ifndef PH_WIDTH
    if (s->resting)
        ph_rest_exchange(in, in->table[p->nx] + h);
#endif
}

/* The ledger of the communication step starts at zero. */
void ph_clear_ledger(ph_instance *in) {
    const ph_plan *p = in->step.plan;
    for (int i = 0; i < PH_ROW_PAIRS; i++)
        ph_clear(in->row[i], p->ncomp);
    ph_clear(in->row[PH_ROW_PAIRS], p->nq);
}

/* So do its other sums. */
void ph_begin_step(ph_instance *in, double h) {
    const ph_plan *p = in->step.plan;
    ph_real *a = in->table + in->offset[PH_A];
    memcpy(in->x_old, in->table, sizeof(ph_real) * (size_t)(p->nx + 1 + p->na));
    if (p->nu > 0)
        memcpy(in->u_old, in->u, sizeof(ph_real) * (size_t)(p->nu * p->k));
    ph_clear_ledger(in);
    ph_clear(in->table + in->offset[PH_Y_STEP], p->nq);
    ph_clear(in->y_node, p->k > 1 ? p->nq * p->k : 0);
    for (int l = 0; l < p->nmean && !p->carries; l++)
        a[p->mean_a[l]] = PH_REAL_SPREAD(0.0);
    in->head->parts = 0;
    in->head->step_h = h;
}

/* The matrix of the factor, for the next step. */
static void keep(ph_instance *in) {
    ph_system *s = &in->step;
    in->head->kept = s->plan->keep_most > 0 && s->lu.filled && s->lu.ready;
    if (in->head->kept && !s->holds)
        memcpy(s->kept, s->factored, sizeof(ph_real) * (size_t)s->plan->nnz);
    s->holds = in->head->kept;
}

/* Books the step into the cumulative sums. */
void ph_finish_step(ph_instance *in, double t) {
    const ph_plan *p = in->step.plan;
    ph_real *energy = in->table + in->offset[PH_ENERGY], *supplied = in->table + in->offset[PH_SUPPLIED];
    ph_real *dissipated = in->table + in->offset[PH_DISSIPATED];
    ph_real *residual = in->table + in->offset[PH_RESIDUAL], *rest = in->table_rest;
    for (int j = 0; j < p->nq; j++)
        ph_add(&energy[j], rest++, in->row[PH_ROW_PAIRS][j]);
    for (int c = 0; c < p->ncomp; c++) {
        ph_real stored = in->row[PH_ROW_STORED][c], lost = in->row[PH_ROW_DISSIPATED][c];
        ph_real given = in->row[PH_ROW_SUPPLIED][c];
        ph_add(&supplied[c], rest++, given);
        ph_add(&dissipated[c], rest++, lost);
        ph_add(&residual[c], rest++, stored + lost + in->row[PH_ROW_NUMERICAL][c] - given);
    }
    if (in->step.lu.ready)
        memcpy(in->step.pivot, in->step.lu.pivot, sizeof(int) * (size_t)p->nw);
    keep(in);
    in->table[p->nx] = PH_REAL_SPREAD(t);
    in->head->theta = 1.0;
    in->head->dirty = 1;
    in->count[PH_STEPS]++;
}
