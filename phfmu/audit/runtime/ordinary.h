/* Rows of a ledger summed and judged in one pass, as booked_steps.py, run_sums.py and judge.py do by arrays,
 * with the same bits.
 *
 * Only for ordinary rows: all numbers finite, all energies within what is allowed.  The first row that is not
 * ends the pass of a run, whose caller takes the whole block by arrays, which know what to say of it; a sweep
 * goes on, and tells by how much. */
#ifndef PH_ORDINARY_H
#define PH_ORDINARY_H

#include <stddef.h>

#include "real.h"

/* Sums high + low of any number of terms. */
typedef struct ph_sums {
    ph_real *high, *low;
} ph_sums;

/* n rows of c components, q port pairs, of junctions and parts of their energies.  [..] lengths; all owned by
 * the caller. In, by rows: H0 .. varying; numerical, moved and works may be NULL.  In, of the booking: judged
 * [c] or 0; owner [q]: component, or -1; port [q]: of a pair; junction [q]: or -1; outside [q]: sign of what
 * enters the balance, or 0; part_junction [parts]; projection [parts]: it is a loss.  before [c]: H booked at
 * the start. In and out, up to the last row: the sums (gross: of |pairs| of a component, created: of |energy|
 * that a junction made in a row); reach, largest, stirred [c], passed [junctions]: most so far; turnover [c]:
 * sum of moved; worst [c], with the row and residual of it, the row -1 for none of these; worst_junction
 * [junctions], worst_part [parts].  scratch [7c + 7 junctions].  violated: the largest share of what is
 * allowed of what rows that are not ordinary miss beside residuals. */
typedef struct ph_accounts {
    ptrdiff_t n, c, q, junctions, parts, loose;
    double rtol;
    const ph_real *H0, *H, *stored, *dissipated, *supplied, *numerical, *moved, *pairs, *works;
    const ph_real *varying;
    const ptrdiff_t *judged, *owner, *port, *junction;
    const double *outside;
    const ptrdiff_t *part_junction, *projection;
    ph_real *before;
    ph_sums of_dissipated, of_supplied, of_numerical, of_stored, gap, missed, squares, gross; /* [c] */
    ph_sums of_port, of_junction, exchanged, created, of_part; /* [ports], [junctions] three times, [parts] */
    ph_sums dissipation, external, residual, unexplained, dH, loss, left; /* [1] of the network */
    ph_real *reach, *largest, *stirred, *turnover, *passed;
    ph_real *worst, *worst_residual;
    ptrdiff_t *worst_row;
    ph_real *worst_junction, *worst_part, worst_unexplained;
    ph_real *scratch;
    ph_real violated;
} ph_accounts;

/* Adds row i and judges it; whether it is ordinary, for finite numbers. */
ph_truth ph_account(ph_accounts *b, ptrdiff_t i);
/* The largest share of what is allowed that a component misses or has too much, in a row or in all of them.
 */
ph_real ph_worst_share(const ph_accounts *b);

#endif
