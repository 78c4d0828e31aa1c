/* The scalars that the variables of a call stand for. */
#include "fmi3_arrays.h"

static int check_count(const fmu *f, const char *function, size_t expected, size_t given) {
    if (expected == given)
        return FMU_OK;
    return fmu_refuse(f, "%s: %zu values for %zu scalar variables", function, given, expected);
}

/* Number of scalars of a variable; references that are not there are refused where they are used. */
static size_t size_of(const fmu *f, unsigned ref) {
    return ref < (unsigned)f->about->nvariable ? (size_t)f->about->sizes[ref] : 1;
}

int fmi3_scalars(fmu *f, const char *function, int half, const unsigned *ref, size_t n, size_t nvalues,
                 const unsigned **scalars) {
    size_t total = 0, room;
    unsigned *place;
    *scalars = ref;
    if (!f || !f->about->sizes)
        return check_count(f, function, n, nvalues);
    for (size_t i = 0; i < n; i++)
        total += size_of(f, ref[i]);
    if (check_count(f, function, total, nvalues))
        return FMU_ERROR;
    room = (size_t)f->about->nvariable;
    if (total > room)
        return fmu_refuse(f, "%s: %zu values in one call, the unit has %zu variables; name none twice",
                          function, total, room);
    place = f->scalars + (half ? room : 0);
    *scalars = place;
    for (size_t i = 0; i < n; i++)
        for (unsigned k = 0; k < (unsigned)size_of(f, ref[i]); k++)
            *place++ = ref[i] + k;
    return FMU_OK;
}
