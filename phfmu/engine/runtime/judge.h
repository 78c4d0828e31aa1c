/* The rule by which a ledger judges, the same for a run, for the file of one, for a sweep and for a step that
 * is to be accepted (ph_closes): judge.py works with arrays what stands here for one number, and reads the
 * constants from here. Energies in joule. */
#ifndef PH_JUDGE_H
#define PH_JUDGE_H

#include <float.h>
#include <math.h>

#include "names.h"
#include "real.h"

/* The residual allowed in a step, relative to the energies in play, unless the ledger is given another
 * number. */
#define PH_RTOL 1e-11
/* Roundings of the largest energy in play so far that a residual may be: constraint forces do work of their
 * own that cancels; measured: 4 in networks of machines, 2e3 in the fast heavy top, whose first term covers
 * it 20 times. */
#define PH_REACH_ULPS 1024
/* Roundings of what of H is not constant, and of what is summed twice. */
#define PH_ULPS 64
/* H is a sum of energies that may cancel. None is larger than it was at the start and all that has moved in
 * the run together; H has this many roundings of that. */
#define PH_PARTS 4
/* The sum over a run may be this many times the root of the sum of the squares of what its steps are allowed.
 */
#define PH_DEVIATIONS 4
/* The residual that is always allowed: of energies below it squares, and in the end they themselves, have no
 * digits left.
 */
#define PH_LEAST 1e-140

/* The larger; NaN where a is not a number. */
static inline ph_real ph_most(ph_real a, ph_real b) {
    return PH_REAL_WHERE(b > a, b, a);
}

/* Energies in play in a step: `inside` the component, and `pairs`, the sum of |energy| through its port
 * pairs. */
static inline ph_real ph_in_play(ph_real inside, ph_real stored, ph_real supplied, ph_real dissipated,
                                 ph_real numerical, ph_real pairs) {
    return ph_most(PH_REAL_ABS(inside), PH_REAL_ABS(stored)) + PH_REAL_ABS(supplied) +
           PH_REAL_ABS(dissipated) + PH_REAL_ABS(numerical) + pairs;
}

/* The residual allowed in a step; `reach`: the most in play so far, the sum of the changes of H included;
 * `varying`: what of H is not constant, and of a relation what is in play in the network. */
static inline ph_real ph_allowed(double rtol, ph_real in_play, ph_real reach, ph_real varying) {
    return rtol * in_play + (PH_REACH_ULPS * DBL_EPSILON * reach + PH_LEAST) +
           PH_ULPS * DBL_EPSILON * varying;
}

/* The sum of the residuals that is allowed; `squares`: the sum of the squares of what the steps are allowed.
 */
static inline ph_real ph_allowed_in_run(ph_real squares) {
    return PH_DEVIATIONS * PH_REAL_SQRT(squares);
}

/* The allowed difference of H and its booked value, beside the residual allowed in the step; `largest`: |H|
 * so far, `turnover`: the sum over the steps so far of what moved between the energies of the component. */
static inline ph_real ph_rounding_of_H(ph_real largest, ph_real turnover) {
    return PH_ULPS * DBL_EPSILON * largest + PH_PARTS * DBL_EPSILON * turnover;
}

/* |size| / allowed, 0 for 0/0. */
static inline ph_real ph_share(ph_real size, ph_real allowed) {
    return PH_REAL_WHERE(size == 0.0, PH_REAL_SPREAD(0.0), PH_REAL_ABS(size) / allowed);
}

#endif
