/* Limits of changes of modes. */
#ifndef PH_MODE_LIMITS_H
#define PH_MODE_LIMITS_H

/* Singular values below this part of the largest are none. */
#define PH_RANK 1e-10
/* Times that the equation of an impulse is solved; the second and third correct
 * rounding.
 */
#define PH_PASSES 3
/* Length of the short step, as a part of the step of the run; rounding of mu, and of c
 * and rows, as parts of their typical magnitudes; modes that are tried. */
#define PH_SHORT 1e-6
#define PH_MU 1e-9
#define PH_C 1e-11
#define PH_MOST_TRIED 4096
/* The fraction of a typical multiplier that counts as zero. */
#define PH_ZERO 1e-6
/* A multiplier that a landed opening leaves, as a part of its typical magnitude. */
#define PH_CUT_LANDED 1e-6

#endif
