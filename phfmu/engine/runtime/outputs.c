/* End values: the instant system. */
#include <string.h>

#include "system.h"

/* Instant system at the present x, t and u. It starts from the step means and looks for pivots anew, so
 * that end values do not depend, not even in the last bit, on when others were read before. */
static int solve_instant(ph_instance *in) {
    ph_system *s = &in->instant;
    const double *mean = in->table + in->offset[PH_A];
    long long begun;
    int status;
    for (int l = 0; in->head->parts > 0 && l < s->plan->nmean; l++)
        s->last[s->plan->mean_w[l]] = mean[s->plan->mean_a[l]];
    *s->last_h = 0.0;
    s->lu.ready = s->lu.filled = 0;
    ph_inputs_at(in, in->head->theta, s->y + s->plan->nw);
    in->count[PH_INSTANTS]++;
    begun = in->count[PH_ITERATIONS];
    s->most = begun + PH_MOST_ITERATIONS;
    status = ph_solve(s, 1.0);
    if (status == PH_OK)
        return status;
    ph_explain(s, status, &in->report);
    in->report.instant = 1;
    in->report.spent = (int)(in->count[PH_ITERATIONS] - begun);
    in->report.time = in->table[s->plan->nx];
    in->report.h = 0.0;
    ph_lu_adopt(&s->lu, s->pivot);
    return status;
}

int ph_refresh(ph_instance *in) {
    ph_system *s = &in->instant;
    const ph_plan *p = s->plan;
    double *a = in->table + in->offset[PH_A_END];
    int status;
    if (!in->head->dirty)
        return PH_OK;
    if (in->head->placed)
        ph_rest_choose(in);
    status = solve_instant(in);
    if (status)
        return status;
    memcpy(s->last, s->y, sizeof(double) * (size_t)p->nw);
    if (s->resting)
        ph_rest_spread(s);
    for (int l = 0; l < p->nmean; l++)
        a[p->mean_a[l]] = 0.0;
    for (int l = 0; l < p->nmean; l++)
        a[p->mean_a[l]] += p->mean_c[l] * s->y[p->mean_w[l]];
    memcpy(in->table + in->offset[PH_Y_END], s->r + p->nw, sizeof(double) * (size_t)(p->nq + p->nobs));
    ph_eval_ledger(s, in->table + in->offset[PH_H], in->moved, in->lost, in->numerical);
    if (!ph_finite(a, in->offset[PH_NBLOCK] - in->offset[PH_A_END])) {
        in->report = (ph_report){.status = PH_NOT_FINITE, .row = -1, .column = -1, .instant = 1};
        in->report.time = in->table[p->nx];
        ph_lu_adopt(&s->lu, s->pivot);
        return PH_NOT_FINITE;
    }
    if (s->lu.ready)
        memcpy(s->pivot, s->lu.pivot, sizeof(int) * (size_t)p->nw);
    *s->last_h = 1.0;
    in->head->dirty = 0;
    return PH_OK;
}

void ph_take_instant(ph_instance *in, int algebraic) {
    const ph_plan *p = in->model->step;
    double *table = in->table;
    if (algebraic)
        memcpy(table + in->offset[PH_A], table + in->offset[PH_A_END], sizeof(double) * (size_t)p->na);
    memcpy(table + in->offset[PH_Y_STEP], table + in->offset[PH_Y_END], sizeof(double) * (size_t)p->nq);
    for (int i = 0; p->k > 1 && p->nq > 0 && i < p->k; i++)
        memcpy(in->y_node + i * p->nq, table + in->offset[PH_Y_END], sizeof(double) * (size_t)p->nq);
}

int ph_initialise(ph_instance *in) {
    int status = ph_refresh(in);
    if (status)
        return status;
    ph_take_instant(in, 1);
    ph_seed(in, in->table + in->offset[PH_A]);
    return PH_OK;
}
