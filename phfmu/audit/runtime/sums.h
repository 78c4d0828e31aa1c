/* Compensated sums: the rounding error of every addition is found exactly and summed beside it. */
#ifndef PH_SUMS_H
#define PH_SUMS_H

#include <math.h>
#include <stddef.h>

#include "real.h"

#if defined(_WIN32)
#define PH_API __declspec(dllexport)
#else
#define PH_API __attribute__((visibility("default")))
#endif

/* What the addition after = before + x has rounded off. */
static inline ph_real ph_rounded_off(ph_real before, ph_real x, ph_real after) {
    const ph_real part = after - before;
    return (before - (after - part)) + (x - part);
}

#endif
