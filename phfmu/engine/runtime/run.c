/* Many steps in one call, recorded. */
#include <string.h>

#include "system.h"

static void put(const ph_column *column, int row, const double *from, int n) {
    if (column->data && n > 0)
        memcpy(column->data + row * column->stride, from, sizeof(double) * (size_t)n);
}

void ph_write_row(ph_instance *in, const ph_record *r, int row) {
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
            const double *u = r->input + *done * r->input_stride;
            status = r->at_nodes ? ph_set_node_inputs(in, u) : ph_set_input(in, u);
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
        ph_write_row(in, r, *done);
    }
    return PH_OK;
}
