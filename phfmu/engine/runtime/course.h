/* The course of Newton's method: what its updates say of the next one. */
#ifndef PH_COURSE_H
#define PH_COURSE_H

#include "system.h"

/* An update this small, and smaller than the last one by this factor, lets the next iteration keep the
 * matrix: it contracts about as fast as a new one would, and the polish settles the rest. */
#define CHORD 1e-1
#define CONTRACTION 0.1

typedef struct ph_course {
    double update, previous, least; /* the last update, the one before, the smallest before it */
    int chord;                      /* the iteration keeps the matrix of the one before */
    int grew, stalls, wanders;
} ph_course;

/* The verdict on an update; from PH_AT_FLOOR on: solved if the residual is rounding, PH_CRAWLS: by the
 * nominal size of unknowns. */
typedef enum ph_verdict { PH_UNSOLVED, PH_SOLVED, PH_AT_FLOOR, PH_CRAWLS } ph_verdict;

static inline ph_course ph_course_begun(ph_newton_kind kind) {
    return (ph_course){.update = INFINITY, .previous = INFINITY, .least = INFINITY, .chord = kind == PH_KEPT};
}

static inline void ph_course_watch(ph_course *c, double update) {
    c->update = update;
    c->grew |= update > c->previous && update > PH_TOLERANCE;
    c->stalls = update > PH_SHRINKING * c->previous && update <= PH_GROWN * c->previous ? c->stalls + 1 : 0;
    c->wanders = update < c->least ? 0 : c->wanders + 1;
    c->least = fmin(c->least, update);
}

/* Update small enough that one polish reaches rounding. Two updates tell what is left after it, whether they
 * shrink linearly (a kept factor, delta against a nearly singular matrix) or by squares; once one grew, as
 * stiff and free directions take turns, both must be small. Two in a row that hardly shrink are at the floor
 * if the residual before the last is rounding, or if they are tiny and only noise is left; so are many of
 * which none is the smallest yet, which wander where constraints nearly lose rank. any: however large they
 * are, as they may be those of multipliers alone. */
static inline ph_verdict ph_course_verdict(const ph_course *c, int any) {
    const double ratio = c->update / c->previous;
    const int crawls = ratio > PH_CRAWL && ratio < 1.0;
    if (c->update == 0.0)
        return PH_SOLVED;
    if (c->chord &&
        !isfinite(c->previous)) /* the first update of a factor from before says nothing of the next */
        return PH_UNSOLVED;
    if (c->update <= PH_TOLERANCE && (!c->grew || c->previous <= PH_TOLERANCE) &&
        ratio * ratio * c->update <= PH_ROUNDING)
        return PH_SOLVED;
    if (c->chord || (!any && c->update > (crawls ? PH_CRAWLING : PH_STAGNATION)))
        return PH_UNSOLVED;
    if (c->wanders >= PH_WANDERING)
        return PH_AT_FLOOR;
    if (ratio <= PH_SHRINKING || c->stalls < PH_STALLS)
        return PH_UNSOLVED;
    if (ratio >= 1.0 - PH_SAME_UPDATE && c->update <= PH_TOLERANCE)
        return PH_SOLVED;
    return crawls ? PH_CRAWLS : PH_AT_FLOOR;
}

/* Towards the next iteration; 1 if the old matrix led astray: the update is to be taken back. */
static inline int ph_course_goes_on(ph_course *c, ph_newton_kind kind) {
    const int kept = c->chord;
    c->chord = 0;
    if (kept && c->update > c->previous)
        return 1;
    c->chord = kind <= PH_CHORD && !c->grew && c->update <= CHORD && c->update <= CONTRACTION * c->previous;
    c->previous = c->update;
    return 0;
}

#endif
