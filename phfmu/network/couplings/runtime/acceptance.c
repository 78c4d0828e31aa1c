/* When the iteration of a step of coupled members is accepted. */
#include "acceptance.h"

void ph_coupled_note(const ph_rules *r, ph_progress *p, double scaled) {
    const double before = p->scaled, stalling = r->held ? PH_COUPLED_STALLING : PH_COUPLED_SHRINKING;
    p->stalled = p->trials > 1 && scaled > PH_COUPLED_SHRINKING * before;
    p->stalls += p->trials > 1 && scaled > stalling * before;
    p->scaled = scaled;
    p->trials++;
}

int ph_coupled_asks_energy(const ph_rules *r, const ph_progress *p) {
    const double solved = r->held && p->stalled ? PH_COUPLED_STAGNATION : PH_COUPLED_ROUNDING;
    return p->scaled <= solved || p->stalls >= PH_COUPLED_STALLS || (p->stalled && p->matrices > 1);
}

int ph_coupled_accepted(const ph_rules *r, const ph_progress *p, int floor, int left) {
    const int resolved =
        p->scaled <= r->repeated || (p->stalls >= PH_COUPLED_STALLS && p->scaled <= PH_COUPLED_NEARLY);
    if (r->repeated > 0.0 && resolved)
        return PH_BY_FLOOR;
    if (p->stalled && ((p->matrices > 0 && floor) || p->resting))
        return PH_BY_FLOOR;
    if (left == PH_TOO_MUCH || (left == PH_WHERE_STALLED && !(r->held && p->stalled)))
        return PH_NOT_YET;
    if (p->scaled <= PH_COUPLED_ROUNDING)
        return PH_BY_ENERGY;
    if (r->held && p->stalled && p->scaled <= PH_COUPLED_STAGNATION)
        return PH_BY_FLOOR;
    if (p->stalls >= PH_COUPLED_STALLS && left == PH_WITHIN && (r->held || p->matrices > 1))
        return PH_BY_FLOOR;
    return PH_NOT_YET;
}

int ph_coupled_takes_matrix(const ph_rules *r, const ph_progress *p, int left) {
    return r->held || p->matrices == 0 || (p->stalled && (p->matrices < 2 || left != PH_WITHIN));
}
