/* The number of runs that are stepped side by side: apart from wide.h, as it is known before real.h is read.
 */
#ifndef PH_LANE_WIDTH
#define PH_LANE_WIDTH 8
#endif
