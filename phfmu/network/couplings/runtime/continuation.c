/* Where a step starts from: the continuation of the ones before. */
#include <string.h>

#include "master.h"
#include "system.h"

static size_t bytes(int n) {
    return sizeof(double) * (size_t)n;
}

/* z = the continuation of the last step, with the line through what that missed in the last two. */
void ph_continue_ahead(ph_master *m) {
    const int all = m->nxi + 2 * m->nbare;
    memcpy(m->plain, m->found, bytes(all));
    ph_clear(m->plain, m->nxi);
    for (int e = 0; e < m->nahead; e++)
        m->plain[m->ahead_to[e]] += m->ahead[e] * m->found[m->ahead_from[e]];
    for (int i = 0; i < all; i++) {
        m->z[i] = m->plain[i];
        if (m->known == 1)
            m->z[i] += m->missed[i];
        else if (m->known == 2)
            m->z[i] += 2.0 * m->missed[i] - m->missed_before[i];
    }
}

/* z is what was found; ahead: it was begun from the continuation. */
void ph_continue_keep(ph_master *m, int ahead) {
    const int all = m->nxi + 2 * m->nbare;
    for (int i = 0; i < all && ahead; i++) {
        m->missed_before[i] = m->missed[i];
        m->missed[i] = m->z[i] - m->plain[i];
    }
    m->known = ahead ? (m->known > 0 ? 2 : 1) : 0;
    memcpy(m->found, m->z, bytes(all));
}
