/* Impulses at the ports of an instance, at the start and at the end of a step:
 *
 *     x0* = x + L(x) s0,   the step,   x1 = x1* + L(x1*) s1.
 *
 * Two maps of the state outside the step, which does not know them; the twin of engine/impulses.py, where the
 * equations are. They live in memory of their own, beside that of the instance. */
#ifndef PH_IMPULSES_H
#define PH_IMPULSES_H

#include "phfmu.h"

/* Actions of impulses s at the ports of a model; functions of all states x and parameters p. */
typedef struct ph_ports {
    int n;                      /* scalar ports with impulses */
    int nstate;                 /* states these move */
    const int *pair;            /* n: pairs of the plan */
    const int *state;           /* nstate */
    const ph_function *shift;   /* (x, p, s) -> L s (nstate), mean of y along it (n) */
    const ph_function *jump;    /* (x, p) -> S = L^T H'' L (n*n) */
    const ph_function *tangent; /* (x, p, s, dx, ds) -> change of L s (nstate) */
    const ph_function *slopes; /* (x, p, s, dx, dp) -> that of L s by p alone (nstate), of S (n*n); or NULL */
} ph_ports;

typedef struct ph_impulses ph_impulses;

/* Bytes of memory, aligned for double and owned by the caller. */
PH_API size_t ph_impulses_size(const ph_instance *in, const ph_ports *ports);
/* The impulses of an instance, zero; instance and ports must outlive them. */
PH_API ph_impulses *ph_impulses_init(void *memory, ph_instance *in, const ph_ports *ports);
/* s: 2 n values, those at the start, then those at the end of the coming steps; they stay until set. Values
 * that are not finite are refused with PH_VALUE and change nothing. */
PH_API int ph_set_impulses(ph_impulses *m, const double *s);
/* 4 n values that belong to a saved state: of the coming steps, and of the last one. */
PH_API double *ph_impulse_values(ph_impulses *m);
/* ph_step_parts with impulses; steps of no length and slivers take none. On failure the instance is where it
 * was. */
PH_API int ph_step_impulses(ph_impulses *m, double t, double h, int n);
/* The impulses at once, without a step: time becomes t, the state moves, their work is booked. On failure the
 * instance is where it was. */
PH_API int ph_kick(ph_impulses *m, double t);
/* One more impulse s (n) at the end of the last step, which counts as part of it. On failure the instance is
 * where it was. */
PH_API int ph_kick_more(ph_impulses *m, const double *s);
/* S at the present time: n*n, symmetric. */
PH_API void ph_jump(ph_impulses *m, double *s);
/* Directions of the last step: dx (count rows of nx+1+na) of the states goes through the impulse at its
 * start, or at its end, along the directions ds (count*n) of the impulse. */
PH_API void ph_impulses_along(ph_impulses *m, int end, int count, const double *ds, double *dx);
/* Directions of the states for one direction dp (np) of the parameters, which does not move the states before
 * the impulse; where the ports have slopes. */
PH_API void ph_impulses_by(ph_impulses *m, int end, const double *dp, double *dx);
/* Change of S at the present time (n*n) along dx (nx) and dp (np); where the ports have slopes. */
PH_API void ph_jump_along(ph_impulses *m, const double *dx, const double *dp, double *dS);

#endif
