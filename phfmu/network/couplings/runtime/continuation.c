/* Where a step starts from: the continuation of the ones before. */
#include <string.h>

#include "master.h"
#include "system.h"

static size_t bytes(int n) {
    return sizeof(double) * (size_t)n;
}

/* z = the continuation of the last step, with the polynomial through what that missed in the steps known. */
void ph_continue_ahead(ph_master *m) {
    const int all = m->nxi + 2 * m->nbare;
    memcpy(m->plain, m->found, bytes(all));
    ph_clear(m->plain, m->nxi);
    for (int e = 0; e < m->nahead; e++)
        m->plain[m->ahead_to[e]] += m->ahead[e] * m->found[m->ahead_from[e]];
    memcpy(m->z, m->plain, bytes(all));
    for (int j = 0, factor = m->known; j < m->known; j++) {
        for (int i = 0; i < all; i++)
            m->z[i] += factor * m->missed[j * all + i];
        factor = -factor * (m->known - j - 1) / (j + 2);
    }
}

/* z is what was found; ahead: it was begun from the continuation. */
void ph_continue_keep(ph_master *m, int ahead) {
    const int all = m->nxi + 2 * m->nbare;
    if (ahead) {
        memmove(m->missed + all, m->missed, bytes(all * (PH_COUPLED_KNOWN - 1)));
        for (int i = 0; i < all; i++)
            m->missed[i] = m->z[i] - m->plain[i];
    }
    m->known = !ahead ? 0 : m->known < PH_COUPLED_KNOWN ? m->known + 1 : m->known;
    memcpy(m->found, m->z, bytes(all));
}
