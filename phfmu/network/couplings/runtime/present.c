/* Signals at the end of an accepted step, for what members tell there: other inputs are on their polynomials,
 * and each wire passes on what its source gives under inputs that are there already. */
#include "master.h"
#include "system.h"

int ph_signals_present(ph_master *m) {
    for (int w = 0; w < m->nwire; w++) {
        const ph_share *to = &m->shares[m->wire_target[w]];
        ph_clear(to->now, to->nu);
        for (int i = 0; i < to->k; i++)
            for (int j = 0; j < to->nu; j++)
                to->now[j] += to->at_end[i] * to->u[i * to->nu + j];
    }
    for (int w = 0; w < m->nwire; w++) {
        const ph_share *from = &m->shares[m->wire_source[w]], *to = &m->shares[m->wire_target[w]];
        int status = ph_share_said(m, m->wire_source[w], from->kind->refresh(from));
        if (status)
            return status;
        to->now[m->wire_input[w]] = m->factor[w] * from->end[m->wire_output[w]] + to->free[m->wire_input[w]];
        status = ph_share_said(m, m->wire_target[w], to->kind->present(to));
        if (status)
            return status;
    }
    return PH_OK;
}
