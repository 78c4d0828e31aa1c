/* One block of memory that is handed out in parts. */
#ifndef PH_POOL_H
#define PH_POOL_H

#include <stddef.h>

#include "real.h"

/* Without a block it only counts. */
typedef struct ph_pool {
    char *base;
    size_t used;
} ph_pool;

#ifdef PH_WIDTH
#define PH_ALIGNED sizeof(ph_real)
#else
#define PH_ALIGNED 16
#endif

/* Any type may begin behind so many bytes. */
static inline size_t ph_padded(size_t bytes) {
    return (bytes + PH_ALIGNED - 1) / PH_ALIGNED * PH_ALIGNED;
}

static inline void *ph_take(ph_pool *pool, size_t bytes) {
    const size_t at = pool->used;
    pool->used += ph_padded(bytes);
    return pool->base ? pool->base + at : NULL;
}

static inline double *ph_take_doubles(ph_pool *pool, int n) {
    return ph_take(pool, sizeof(double) * (size_t)n);
}

static inline ph_real *ph_take_reals(ph_pool *pool, int n) {
    return ph_take(pool, sizeof(ph_real) * (size_t)n);
}

static inline int *ph_take_ints(ph_pool *pool, int n) {
    return ph_take(pool, sizeof(int) * (size_t)n);
}

#endif
