/* The tape of a run: what the way back needs of each accepted part of a step. */
#include <string.h>

#include "reverse.h"

int ph_tape_width(const ph_model *model) {
    const ph_plan *p = model->step;
    return 2 + p->nx + p->nw + p->nu * p->k;
}

static double *put(double *to, const double *from, int n) {
    if (n > 0)
        memcpy(to, from, sizeof(double) * (size_t)n);
    return to + n;
}

static void take(ph_tape *tape, const ph_instance *in, double h) {
    const ph_plan *p = in->step.plan;
    const double *w = in->step.resting ? in->unspread : in->step.y;
    const double t = in->table[p->nx];
    double *to;
    while (tape->n > 0 && tape->rows[(size_t)(tape->n - 1) * (size_t)tape->width] >= t)
        tape->n--;
    if (tape->n == tape->room) {
        tape->full = 1;
        return;
    }
    to = tape->rows + (size_t)tape->n * (size_t)tape->width;
    tape->n++;
    *to++ = t;
    *to++ = h;
    to = put(to, in->table, p->nx);
    to = put(to, w, p->nw);
    put(to, in->step.y + p->nw, p->nu * p->k);
}

void ph_tape_on(ph_instance *in, ph_tape *tape, double *rows, int room) {
    if (tape)
        *tape = (ph_tape){.take = take, .rows = rows, .room = room, .width = ph_tape_width(in->model)};
    in->tape = tape;
}
