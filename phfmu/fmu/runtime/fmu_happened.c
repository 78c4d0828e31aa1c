/* State events of a unit, whoever lands on them: what is booked of them, and why one could not happen. Only
 * units with state events have this file. */
#include <stdio.h>

#include "events.h"
#include "fmu.h"

void fmu_happened(fmu *f, int n, double t, const double *energy, const double *lost) {
    for (int c = 0; c < f->sizes.ncomp; c++) {
        f->books.jumped[c] += energy[c];
        f->phase.happened[2] += lost[c];
    }
    f->phase.happened[0] += n;
    f->phase.happened[1] = t;
    f->phase.crossed = 1;
}

/* In the order of ph_event_reason; texts with the numbers of the refusal where it has some. */
static void reason(const ph_event_refusal *r, char *text, size_t size) {
    switch (r->reason) {
    case PH_REFUSED_DEPENDENT:
        snprintf(text, size, "their jumps depend on each other");
        break;
    case PH_REFUSED_MOST:
        snprintf(text, size, "it would jump with |c| = %.6g, more than its most = %.6g", r->value, r->limit);
        break;
    case PH_REFUSED_GAIN:
        snprintf(text, size, "their jumps together gain %.6g J: their restitutions differ", r->value);
        break;
    case PH_REFUSED_PILE:
        snprintf(text, size, "%d events fall into one step: the model does not say where they come to rest",
                 PH_MOST_EVENTS);
        break;
    case PH_REFUSED_SLIDES:
        snprintf(
            text, size,
            "%d events fall into one step, at one instant: the model does not say where a bounce comes to "
            "rest, or it slides",
            PH_MOST_EVENTS);
        break;
    default:
        snprintf(text, size, "it happens again at the same instant, after each event was tried");
    }
}

int fmu_event_refused(const fmu *f, const char *function, const ph_event_refusal *r, int n,
                      const char *const *guards) {
    char text[192], names[256] = "";
    size_t used = 0;
    for (int i = 0; i < n && used < sizeof(names); i++)
        if (r->fired[i])
            used +=
                (size_t)snprintf(names + used, sizeof(names) - used, "%s'%s'", used ? ", " : "", guards[i]);
    reason(r, text, sizeof(text));
    return fmu_say(f, FMU_DISCARD, FMU_LOG_ERRORS,
                   "%s: %s. At t = %.9g s %s: %s. The component is back at t = %.9g s", function,
                   ph_status_text(PH_EVENT), r->t, names, text, fmu_time(f));
}
