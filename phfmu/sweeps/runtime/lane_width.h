/* Runs side by side. It comes before all that is compiled for so many of them, as real.h asks for it. */
#ifndef PH_LANE_WIDTH
#define PH_LANE_WIDTH 8
#endif
