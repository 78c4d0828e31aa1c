/* Steps one after the other as one step: for units that change parameters within a communication step. */
#include <string.h>

#include "system.h"

static const ph_row SUMS[] = {PH_ROW_STORED, PH_ROW_DISSIPATED, PH_ROW_SUPPLIED, PH_ROW_NUMERICAL,
                              PH_ROW_MOVED};
enum { NSUM = sizeof(SUMS) / sizeof(SUMS[0]) };

int ph_kept_size(const ph_model *model) {
    const ph_plan *p = model->step;
    return NSUM * p->ncomp + 2 * p->nq + p->na;
}

static void take(double **to, const double *from, int n) {
    if (n > 0)
        memcpy(*to, from, sizeof(double) * (size_t)n);
    *to += n;
}

void ph_keep(const ph_instance *in, double *kept) {
    const ph_plan *p = in->step.plan;
    for (int i = 0; i < NSUM; i++)
        take(&kept, in->row[SUMS[i]], p->ncomp);
    take(&kept, in->row[PH_ROW_PAIRS], p->nq);
    take(&kept, in->table + in->offset[PH_Y_STEP], p->nq);
    take(&kept, in->table + in->offset[PH_A], p->na);
}

static const double *add(double *to, const double *kept, int n) {
    for (int i = 0; i < n; i++)
        to[i] += kept[i];
    return kept + n;
}

static const double *mean(double *to, const double *kept, int n, double part) {
    for (int i = 0; i < n; i++)
        to[i] = part * kept[i] + (1.0 - part) * to[i];
    return kept + n;
}

void ph_join(ph_instance *in, const double *kept, double part) {
    const ph_plan *p = in->step.plan;
    double *y = in->table + in->offset[PH_Y_STEP];
    for (int i = 0; i < NSUM; i++)
        kept = add(in->row[SUMS[i]], kept, p->ncomp);
    kept = add(in->row[PH_ROW_PAIRS], kept, p->nq);
    kept = mean(y, kept, p->nq, part);
    if (!p->carries)
        mean(in->table + in->offset[PH_A], kept, p->na, part);
    for (int node = 0; p->k > 1 && p->nq > 0 && node < p->k; node++)
        memcpy(in->y_node + node * p->nq, y, sizeof(double) * (size_t)p->nq);
}
