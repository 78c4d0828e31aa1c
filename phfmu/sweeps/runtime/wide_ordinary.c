/* The accounts of runs side by side: the source of those of one, with vectors as its numbers. */
#include "lane_width.h"
#define PH_WIDTH PH_LANE_WIDTH

#define ph_account ph_wide_account
#define ph_worst_share ph_wide_worst_share

#include "ordinary.c"
