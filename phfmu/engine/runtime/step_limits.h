/* Limits of a step; the Python engine reads them from here. */
#ifndef PH_STEP_LIMITS_H
#define PH_STEP_LIMITS_H

/* A step this short is what rounding left of a master's clock and no step: in units of eps |t|, and as a part
 * of an internal step. In it multipliers would be the noise of the constraints over h. */
#define PH_SLIVER_CLOCK 2
#define PH_SLIVER_STEP 1e-9

#endif
