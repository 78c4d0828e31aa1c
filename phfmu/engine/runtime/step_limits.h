/* Limits of a step; the Python engine reads them from here. */
#ifndef PH_STEP_LIMITS_H
#define PH_STEP_LIMITS_H

/* A step this short is what rounding left of a master's clock and no step: in units of eps |t|, and as a part
 * of an internal step. In it multipliers would be the noise of the constraints over h. */
#define PH_SLIVER_CLOCK 2
#define PH_SLIVER_STEP 1e-9

/* Newton iterations an internal step may take, all attempts and substeps together; a communication step may
 * take this and some more for each internal step. */
#define PH_MOST_ITERATIONS 2500
#define PH_MORE_ITERATIONS 100

/* Energies, states and outputs of a step may be this large: sums of a million of them are still finite. */
#define PH_LARGEST 1e302

/* Changes of the constraints at rest that an instance remembers, the last ones. */
#define PH_KEPT_CHANGES 16

/* Internal steps of a communication step that may have been halved if there is to be a sensitivity. */
#define PH_KEPT_HALVED 16

#endif
