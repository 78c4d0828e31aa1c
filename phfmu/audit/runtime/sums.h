/* Compensated sums: the rounding error of every addition is found exactly and summed beside it. */
#ifndef PH_SUMS_H
#define PH_SUMS_H

#include <math.h>
#include <stddef.h>

#if defined(_WIN32)
#define PH_API __declspec(dllexport)
#else
#define PH_API __attribute__((visibility("default")))
#endif

/* What the addition after = before + x has rounded off. */
static inline double ph_rounded_off(double before, double x, double after) {
    const double part = after - before;
    return (before - (after - part)) + (x - part);
}

#endif
