/* The parts in which a communication step was solved: its internal steps, and the substeps of those that were
 * halved. Places in an internal step are counted in its smallest substeps. */
#include <string.h>

#include "system.h"

_Static_assert(PH_SMALLEST <= 64, "a bit of halved_ends for each smallest substep");

void ph_parts_begin(ph_instance *in, int n) {
    ph_head *head = in->head;
    head->asked = n;
    head->halved = 0;
    head->first_h = *in->step.last_h;
    memcpy(in->first, in->step.last, sizeof(double) * (size_t)in->step.plan->nw);
}

/* A substep of internal step i of several, or of the whole step, ends at `end`. */
void ph_part_ends(ph_instance *in, int i, int end) {
    ph_head *head = in->head;
    int last = head->halved - 1;
    if (last < 0 || last >= PH_KEPT_HALVED || head->halved_step[last] != i) {
        last = head->halved;
        if (last > PH_KEPT_HALVED)
            return;
        head->halved++;
        if (last == PH_KEPT_HALVED)
            return;
        head->halved_step[last] = i;
        head->halved_ends[last] = 0;
    }
    head->halved_ends[last] |= (uint64_t)1 << (end - 1);
}

int ph_part_end(const ph_instance *in, int i, int at) {
    const ph_head *head = in->head;
    for (int l = 0; l < head->halved && head->parts > 1; l++)
        if (head->halved_step[l] == i) {
            uint64_t ends = head->halved_ends[l] >> at;
            for (at++; !(ends & 1); ends >>= 1)
                at++;
            return at;
        }
    return PH_SMALLEST;
}

/* Substeps of an internal step that end at these places; 0: the last one does not end with it. */
static int substeps(uint64_t ends) {
    int n = 0;
    if (ends >> (PH_SMALLEST - 1) != 1)
        return 0;
    for (; ends; ends &= ends - 1)
        n++;
    return n;
}

int ph_parts_fit(const ph_head *head) {
    const int kept = head->halved < PH_KEPT_HALVED ? head->halved : PH_KEPT_HALVED;
    long long parts = head->asked;
    if (head->parts < 0 || head->asked < 0 || head->halved < 0 || head->halved > PH_KEPT_HALVED + 1)
        return 0;
    for (int l = 0; l < kept; l++) {
        const int n = substeps(head->halved_ends[l]), before = l > 0 ? head->halved_step[l - 1] : -1;
        if (n < 2 || head->halved_step[l] <= before || head->halved_step[l] >= head->asked)
            return 0;
        parts += n - 1;
    }
    return head->parts <= 1 || head->parts == parts || (head->halved > kept && head->parts > parts);
}

int ph_solves(const ph_instance *in) {
    const ph_head *head = in->head;
    return head->parts > 1 && head->halved > PH_KEPT_HALVED ? 0 : head->parts;
}
