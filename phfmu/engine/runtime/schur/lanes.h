/* Lanes: the values of one quantity at the k = PH_K nodes of a step and at its end point, in one vector.
 *
 * Included by the generated kernels of a model with a Schur stepper, after PH_K. Lane arithmetic is that of
 * its elements, operation by operation, whatever vectors the processor has: results do not depend on it. */
#ifndef PH_LANES_H
#define PH_LANES_H

#include <math.h>
#include <string.h>

#include "system.h"

#define PH_LANES (PH_K + 1)
typedef double ph_lane __attribute__((vector_size(8 * PH_LANES), aligned(8)));

#if PH_K == 3
#define PH_SPREAD(a) ((ph_lane){(a), (a), (a), (a)})
#define PH_NODES ((ph_lane){1.0, 1.0, 1.0, 0.0})
#else
#define PH_SPREAD(a) ((ph_lane){(a), (a)})
#define PH_NODES ((ph_lane){1.0, 0.0})
#endif

#define PH_LANE_FUNCTION(f)                                                                                  \
    static inline ph_lane lane_##f(ph_lane a) {                                                              \
        for (int i = 0; i < PH_LANES; i++)                                                                   \
            a[i] = f(a[i]);                                                                                  \
        return a;                                                                                            \
    }
#define PH_LANE_POWER                                                                                        \
    static inline ph_lane lane_pow(ph_lane a, ph_lane b) {                                                   \
        for (int i = 0; i < PH_LANES; i++)                                                                   \
            a[i] = pow(a[i], b[i]);                                                                          \
        return a;                                                                                            \
    }

/* Rows are nearly dependent where n pivots of this size beside the diagonal would be: the last pivot of a
 * straight chain of n links is 1/n of its diagonal without any weakness. Multipliers of nearly dependent
 * constraints change much while F does not, and the turn of G that the sweep neglects acts on them: the
 * sparse Newton takes such steps. Springs have their compliance. */
#define WEAK 3e-3
#define WEAK_SOFT 3e-4

static inline int lane_weak(ph_lane pivot, ph_lane initial, int n) {
    int result = 0;
    for (int i = 0; i < PH_LANES; i++)
        result |= !(n * pivot[i] > WEAK * initial[i]);
    return result;
}

static inline double sum_of(ph_lane a) {
#if PH_K == 3
    return (a[0] + a[2]) + (a[1] + a[3]);
#else
    return a[0] + a[1];
#endif
}

/* One mode of the coupling of the nodes in time: a real one, and for k = 3 a complex one. */
typedef struct ph_mode {
    double real;
#if PH_K == 3
    double re, im;
#endif
} ph_mode;

/* Work space of one instance. Arrays over degrees of freedom have one more entry, which stays zero where it
 * is read: coordinates that are no differences subtract it. */
typedef struct ph_work {
    const ph_schur *c;
    int ready;            /* masses and loads belong to parameters */
    int uneven;           /* masses are too far apart for the Schur stepper */
    int carry;            /* stresses are unknowns of their own: some spring is stiff at this step size */
    double h;             /* of this step */
    double ratio;         /* of h to the last h, for the predictor */
    const double *p;      /* parameters */
    double *inverse_mass; /* ndof+1 */
    double *constant;     /* ndof+1: forces that depend on parameters only */
    double *weight;       /* ndof: 1 / nominal velocity^2 */
    double *velocity;     /* ndof: v at the start of the step */
    double *parameters;   /* np: those the two were computed for */
    double *point;        /* npoint: coordinates at the start of the step */
    ph_lane *u;           /* nu */
    ph_lane *base;        /* ndof: forces that stay during a step */
    ph_lane *x, *f;       /* ndof+1: displacements; q' at the nodes and v at the end */
    ph_lane *v, *n;       /* ndof+1: velocities v = q' - n; shifts n = M^-1 Dg^T mu */
    ph_lane *force;       /* ndof+1: forces, then accelerations */
    ph_lane *next;        /* ndof+1: the next f */
    ph_lane *correction;  /* ndof+1: work */
    ph_lane *slot;        /* gradients of the rows */
    ph_lane *multiplier;  /* nconstraint: lambda at the nodes, then mu */
    ph_lane *row;         /* a row each: right-hand sides, then what was added to multipliers and stresses */
    ph_lane *hard;        /* nentry: factor of the constraints */
    ph_lane *initial;     /* nconstraint: work of the factor */
    double *start;        /* nstrain: C at the start of the step */
    double *slope;        /* nstrain: phi'' */
    double *compliance;   /* nstrain: 1 / (h^2 phi'') */
    ph_lane *stress;      /* nstrain: S */
    ph_lane *defect;      /* nstrain: phi' - S */
    ph_mode *soft;        /* nentry: factor of all rows */
    ph_mode *mode;        /* a row each */
    ph_mode *whole;       /* a row each: work of the factor */
    ph_lane ahead[PH_LANES];
    ph_lane column[PH_K]; /* h A with h b below it, by columns */
    ph_lane multiply[PH_LANES];
} ph_work;

/* A group of the Schur stepper: its loop over some instances, and for strains the one of all their defects.
 */
typedef struct ph_lane_loop {
    void (*evaluate)(const ph_lane_group *, ph_work *, int from, int to);
    void (*relax)(const ph_lane_group *, ph_work *);
} ph_lane_loop;

#endif
