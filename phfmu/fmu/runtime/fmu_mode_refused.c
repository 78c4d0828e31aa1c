/* Refused changes of modes of ideal switches, in words. */
#include <stdio.h>

#include "fmu_modes.h"
#include "modes.h"

int fmu_mode_refused(const fmu *f, const char *function, const ph_mode_refusal *r, int n,
                     const char *const *switches) {
    char names[256] = "", text[128];
    size_t used = 0;
    for (int i = 0; i < n && used < sizeof(names); i++)
        if (r->which[i])
            used +=
                (size_t)snprintf(names + used, sizeof(names) - used, "%s'%s'", used ? ", " : "", switches[i]);
    if (r->reason == PH_REFUSED_MOST)
        snprintf(text, sizeof(text), "it would cut %.6g, more than its most = %.6g", r->value, r->limit);
    else if (r->reason == PH_REFUSED_SHARED)
        snprintf(text, sizeof(text), "it opens, but what it holds depends on others and is not determined");
    else
        snprintf(text, sizeof(text), "no mode of the switches obeys their laws");
    return fmu_say(f, FMU_DISCARD, FMU_LOG_ERRORS,
                   "%s: %s. At t = %.9g s %s: %s. The component is back at t = %.9g s", function,
                   ph_status_text(PH_EVENT), r->t, names, text, fmu_time(f));
}
