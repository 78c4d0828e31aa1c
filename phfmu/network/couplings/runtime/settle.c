/* Rows of an accepted step are rounding of what they are sums of, which at the end of a step is more than it
 * need be: there the outputs are linear in the impulses, and one more makes their sums zero, booked like all.
 * What it leaves in the rows of the impulses is a part of 1e-13 of these. */
#include <math.h>

#include "master.h"
#include "system.h"

int ph_settle(ph_master *m) {
    const int n = m->nxi, nb = m->nbare;
    double *sums = m->rows + n;
    int needed = 0, status;
    for (int b = 0; b < nb; b++)
        needed |= fabs(sums[b]) > PH_COUPLED_END * m->size[n + b];
    if (!needed)
        return PH_OK;
    ph_lap(m->clock, PH_SOLVING);
    status = ph_pair_left(m);
    ph_lap(m->clock, PH_JOINING);
    for (int b = 0; b < nb && status == PH_OK; b++)
        m->z[n + nb + b] += m->moved[b];
    for (int i = 0; i < m->nshare && status == PH_OK; i++)
        status = ph_share_said(m, i, ph_share_more(m, &m->shares[i], m->moved));
    ph_clear(sums, nb);
    for (int i = 0; i < m->nshare && status == PH_OK; i++)
        status = ph_share_said(m, i, ph_share_end(&m->shares[i], n, sums));
    return status;
}
