/* Saved states: written, read back, and looked at before they are believed.
 *
 * A state that this process saved is taken as it is: steps come back to one all the time. One that was
 * written by others may hold anything, and everything in it that chooses a place in memory or bounds a loop
 * is compared with the model before it is loaded. */
#include <string.h>

#include "system.h"

size_t ph_state_size(const ph_instance *in) {
    return in->state_size;
}

void ph_save(const ph_instance *in, void *out) {
    memcpy(out, in->head, in->state_size);
}

/* Pivots whose factors outgrow the reserved memory are none: those of a solve never do. */
static void adopt(ph_system *s) {
    if (ph_lu_adopt(&s->lu, s->pivot) == PH_OK)
        return;
    s->pivot[0] = -1;
    s->lu.known = s->lu.ready = s->lu.filled = 0;
}

/* The place in a saved state of the value that the instance has at `own`. */
static const void *place(const ph_instance *in, const void *from, const void *own) {
    return (const char *)from + ((const char *)own - (const char *)(const void *)in->head);
}

int ph_load(ph_instance *in, const void *from) {
    const ptrdiff_t flags = (char *)in->step.rests - (char *)in->head;
    const size_t length = sizeof(int) * (size_t)in->model->step->nhold;
    ph_head head;
    int others, holds = in->step.holds;
    memcpy(&head, from, sizeof(head));
    if (head.token != in->model->code->token || head.size != in->state_size)
        return PH_ABI;
    others = length > 0 && memcmp(in->step.rests, (const char *)from + flags, length) != 0;
    if (holds) /* of the matrix that is loaded */
        holds = memcmp(in->step.kept, place(in, from, in->step.kept),
                       sizeof(double) * (size_t)in->step.plan->nnz) == 0;
    memcpy(in->head, from, in->state_size);
    if (others)
        ph_rest_take(in);
    adopt(&in->step);
    adopt(&in->instant);
    in->step.holds = holds && in->head->kept;
    return PH_OK;
}

static int is_flag(int value) {
    return value == 0 || value == 1;
}

/* None, or every row once. The work space `dw` marks those that were seen. */
static int pivots_fit(const ph_system *s, const int *pivot) {
    const int n = s->plan->nw;
    if (n == 0 || pivot[0] == -1)
        return 1;
    ph_clear(s->dw, n);
    for (int j = 0; j < n; j++) {
        if (pivot[j] < 0 || pivot[j] >= n || s->dw[pivot[j]] != 0.0)
            return 0;
        s->dw[pivot[j]] = 1.0;
    }
    return 1;
}

static int rests_fit(const ph_instance *in, const void *from, int changes) {
    const int n = in->model->step->nhold, *rests = place(in, from, in->step.rests);
    const ph_rest_change *kept = place(in, from, in->changes);
    for (int c = 0; c < n; c++)
        if (rests[c] != PH_AWAKE && rests[c] != PH_RESTS)
            return 0;
    for (int i = 0; n > 0 && i < changes && i < PH_KEPT_CHANGES; i++)
        if (kept[i].rests < -1 || kept[i].rests >= n || kept[i].needed < -1 || kept[i].needed >= n)
            return 0;
    return changes >= 0 && (n > 0 || changes == 0);
}

/* 1 if all values that may be set are finite, as they are when they are set, and energies too. */
static int values_fit(const ph_instance *in, const void *from) {
    const ph_plan *p = in->model->step;
    return ph_finite(place(in, from, in->table), p->nx + 1) && ph_finite(place(in, from, in->rest), p->nx) &&
           ph_finite(place(in, from, in->u), p->nu * p->k) && ph_finite(place(in, from, in->p), p->np) &&
           ph_finite(place(in, from, in->reach), p->schur ? p->ncomp : 0);
}

const char *ph_state_fault(const ph_instance *in, const void *from) {
    const ph_head *head = from;
    const double lengths[] = {head->last_h[0], head->last_h[1], head->step_h, head->first_h};
    if (head->token != in->model->code->token || head->size != in->state_size)
        return "it belongs to another model, or to another mode";
    if (!is_flag(head->held) || !is_flag(head->kept) || !is_flag(head->dirty) || !is_flag(head->placed))
        return "a flag is neither 0 nor 1";
    if (!ph_finite(lengths, 4) || !(head->theta >= 0.0 && head->theta <= 1.0))
        return "the length of a step is not finite";
    if (!ph_parts_fit(head))
        return "the parts of its last step do not add up";
    if (!rests_fit(in, from, head->changes))
        return "a constraint that rests is not one of the model";
    if (!pivots_fit(&in->step, place(in, from, in->step.pivot)) ||
        !pivots_fit(&in->instant, place(in, from, in->instant.pivot)))
        return "the pivots of a factorisation are not rows of the model";
    return values_fit(in, from) ? NULL : "a state, an input, a parameter or an energy is not finite";
}
