/* Lanes: the values of one quantity at the k = PH_K nodes of a step and at its end point, in one vector, each
 * of them one number or those of several runs (real.h). Numbers that are those of a run are ph_real, what all
 * runs have in common is double.
 *
 * Included by the generated kernels of a model with a Schur stepper, after PH_K. Lane arithmetic is that of
 * its elements, operation by operation, whatever vectors the processor has: results do not depend on it. */
#ifndef PH_LANES_H
#define PH_LANES_H

#include <float.h>
#include <math.h>
#include <string.h>

#include "system.h"

#define PH_LANES (PH_K + 1)
#ifndef PH_LIGHT /* the number of degrees of freedom without mass */
#define PH_LIGHT 0
#endif
typedef double ph_lane __attribute__((vector_size(8 * PH_LANES * PH_RUNS), aligned(8)));

/* PH_NODE: the value at node j of a lane that has a place; PH_SPREAD: the same number of a run at all of
 * them; PH_CONSTANT: of all runs; PH_NODES: 1 at the nodes and 0 at the end. */
#ifdef PH_WIDTH
#define PH_NODE(a, j) (((ph_real *)&(a))[j])
#define PH_SPREAD(a) lane_spread(a, PH_LANES)
#define PH_CONSTANT(a) ((a) - (ph_lane){0.0})
#define PH_NODES lane_spread(PH_REAL_SPREAD(1.0), PH_K)

/* The first n of its values. */
static inline __attribute__((always_inline)) ph_lane lane_spread(ph_real a, int n) {
    ph_lane lane = {0.0};
    for (int j = 0; j < n; j++)
        PH_NODE(lane, j) = a;
    return lane;
}
#else
#define PH_NODE(a, j) ((a)[j])
#define PH_CONSTANT(a) PH_SPREAD(a)
#if PH_K == 3
#define PH_SPREAD(a) ((ph_lane){(a), (a), (a), (a)})
#define PH_NODES ((ph_lane){1.0, 1.0, 1.0, 0.0})
#else
#define PH_SPREAD(a) ((ph_lane){(a), (a)})
#define PH_NODES ((ph_lane){1.0, 0.0})
#endif
#endif

/* ph_inner: a lane whose value at the end nobody reads. That of one run has it, as a vector of so many
 * numbers is no faster with one less; so have several runs of three nodes, as vectors have a power of two.
 * PH_INNER: the nodes of a lane that has a place; PH_OUTER: those with nothing at the end; PH_AT_NODES: a
 * number there.
 */
#if defined(PH_WIDTH) && PH_K == 1
typedef ph_real ph_inner;

#define PH_INNER(a) (*(const ph_inner *)&(a))
#define PH_INNER_SPREAD(a) (a)
#define PH_INNER_CONSTANT(a) PH_REAL_SPREAD(a)
#define PH_OUTER(a) inner_outer(a)
#define PH_AT_NODES(a) (a)

static inline __attribute__((always_inline)) ph_lane inner_outer(ph_inner a) {
    ph_lane lane = PH_CONSTANT(-0.0);
    PH_NODE(lane, 0) = a;
    return lane;
}
#else
typedef ph_lane ph_inner;

#define PH_INNER(a) (a)
#define PH_INNER_SPREAD(a) PH_SPREAD(a)
#define PH_INNER_CONSTANT(a) PH_CONSTANT(a)
#define PH_OUTER(a) (a)
#define PH_AT_NODES(a) (PH_SPREAD(a) * PH_NODES)
#endif

/* Functions of lanes, value by value; kind: lane or inner. */
#define PH_LANE_FUNCTION(kind, f)                                                                            \
    static inline ph_##kind kind##_##f(ph_##kind a) {                                                        \
        for (size_t i = 0; i < sizeof(a) / sizeof(double); i++)                                              \
            a[i] = f(a[i]);                                                                                  \
        return a;                                                                                            \
    }
#define PH_LANE_POWER(kind)                                                                                  \
    static inline ph_##kind kind##_pow(ph_##kind a, ph_##kind b) {                                           \
        for (size_t i = 0; i < sizeof(a) / sizeof(double); i++)                                              \
            a[i] = pow(a[i], b[i]);                                                                          \
        return a;                                                                                            \
    }
/* Operations of numbers that vectors do not have: `expression` of the numbers x, and y, of a run. */
#define PH_NUMBER_OF_ONE(name, expression)                                                                   \
    static inline ph_real number_##name(ph_real a) {                                                         \
        for (int l = 0; l < PH_RUNS; l++) {                                                                  \
            const double x = PH_RUN(a, l);                                                                   \
            PH_RUN(a, l) = expression;                                                                       \
        }                                                                                                    \
        return a;                                                                                            \
    }
#define PH_NUMBER_OF_TWO(name, expression)                                                                   \
    static inline ph_real number_##name(ph_real a, ph_real b) {                                              \
        for (int l = 0; l < PH_RUNS; l++) {                                                                  \
            const double x = PH_RUN(a, l), y = PH_RUN(b, l);                                                 \
            PH_RUN(a, l) = expression;                                                                       \
        }                                                                                                    \
        return a;                                                                                            \
    }

/* Rows are nearly dependent where n pivots of this size beside the diagonal would be: the last pivot of a
 * straight chain of n links is 1/n of its diagonal without any weakness. Multipliers of nearly dependent
 * constraints change much while F does not, and the turn of G that the sweep neglects acts on them: the
 * sparse Newton takes such steps. Springs have their compliance. */
#define WEAK 3e-3
#define WEAK_SOFT 3e-4

static inline ph_truth lane_weak(ph_lane pivot, ph_lane initial, int n) {
    ph_truth result = {0};
    for (int i = 0; i < PH_LANES; i++) {
        const ph_real left = (double)n * PH_NODE(pivot, i), least = WEAK * PH_NODE(initial, i);
#if PH_LIGHT
        const ph_truth above = PH_NODE(initial, i) > 0.0;
        result |= PH_NOT((above & (left > least)) | (PH_NOT(above) & (left < least)));
#else
        result |= PH_NOT(left > least);
#endif
    }
    return result;
}

static inline ph_real sum_of(ph_lane a) {
#if PH_K == 3
    return (PH_NODE(a, 0) + PH_NODE(a, 2)) + (PH_NODE(a, 1) + PH_NODE(a, 3));
#else
    return PH_NODE(a, 0) + PH_NODE(a, 1);
#endif
}

/* One mode of the coupling of the nodes in time: a real one, and for k = 3 a complex one. */
typedef struct ph_mode {
    ph_real real;
#if PH_K == 3
    ph_real re, im;
#endif
} ph_mode;

/* Work space of one instance. Arrays over degrees of freedom have one more entry, which stays zero where it
 * is read: coordinates that are no differences subtract it. Nothing is added to it, as each addition would
 * wait for the one before. */
typedef struct ph_work {
    const ph_schur *c;
    int ready;             /* masses and loads belong to parameters */
    ph_truth uneven;       /* masses are too far apart for the Schur stepper */
    int carry;             /* stresses are unknowns of their own: some spring is stiff at this step size */
    double h;              /* of this step */
    double ratio;          /* of h to the last h, for the predictor */
    const ph_real *p;      /* parameters */
    ph_real *inverse_mass; /* ndof+1 */
    ph_real *constant;     /* ndof+1: forces that depend on parameters only */
    double *weight;        /* ndof: 1 / nominal velocity^2 */
    ph_real *velocity;     /* ndof: v at the start of the step */
    ph_real *parameters;   /* np: those the two were computed for */
    ph_real *point;        /* npoint: coordinates at the start of the step */
    ph_real *light_mass;   /* nlight: their true masses, zero or far smaller than all others */
    ph_real inverse_light; /* 1/m that their rows are eliminated with */
    ph_lane *missing;      /* nlight: what their momentum misses */
    ph_inner *u;           /* nu */
    ph_inner *base;        /* ndof: forces that stay during a step */
    ph_lane *x, *f;        /* ndof+1: displacements; q' at the nodes and v at the end */
    ph_inner *v, *n;       /* ndof+1: velocities v = q' - n; shifts n = M^-1 Dg^T mu */
    ph_inner *force;       /* ndof+1: forces, then accelerations */
    ph_lane *next;         /* ndof+1: the next f */
    ph_inner *correction;  /* ndof+1: work */
    ph_lane *slot;         /* gradients of the rows */
    ph_lane *multiplier;   /* nconstraint: lambda at the nodes, then mu */
    ph_lane *row;          /* a row each: right-hand sides, then what was added to multipliers and stresses */
    ph_lane *hard;         /* nentry: factor of the constraints */
    ph_lane *initial;      /* nconstraint: work of the factor */
    ph_real *start;        /* nstrain: C at the start of the step */
    ph_real *slope;        /* nstrain: phi'' */
    ph_real *compliance;   /* nstrain: 1 / (h^2 phi'') */
    ph_inner *stress;      /* nstrain: S */
    ph_inner *defect;      /* nstrain: phi' - S */
    ph_mode *soft;         /* nentry: factor of all rows */
    ph_mode *mode;         /* a row each */
    ph_mode *whole;        /* a row each: work of the factor */
#ifdef PH_WIDTH
    ph_lane *kept_hard; /* factors and compliances before those of some runs are taken anew */
    ph_mode *kept_soft;
    ph_real *kept_compliance;
#endif
    ph_lane ahead[PH_LANES], onward[PH_K]; /* of velocities, of lambda */
    ph_lane column[PH_K];                  /* h A with h b below it, by columns */
    ph_lane multiply[PH_LANES];
} ph_work;

/* Arguments and results of a sweep. */
typedef struct ph_sweep {
    const ph_schur *c;
    int carry;
    double h;
    const ph_real *parameters;
    ph_real *point, *velocity, *inverse_mass, *constant, *start, *slope;
    const ph_inner *input, *base;
    const ph_real *light_mass;
    ph_real inverse_light;
    ph_lane *missing, *multiplier, *f, *x, *next, *slot, *row;
    ph_inner *v, *n, *force, *stress, *defect;
    ph_lane column[PH_K];
} ph_sweep;

/* A small model has its tables in the generated file, `small_tables`, beside PH_SMALL, the number of its
 * degrees of freedom, and PH_SMALL_ENTRIES, of its factor. Functions that are PH_WRITTEN and loops behind
 * PH_UNROLL are written out where they are used: the compiler knows every index. Arrays over degrees of
 * freedom are taken from the work space by PH_LOCAL and go back by PH_KEEP; in between they are registers.
 * For other models all of this is nothing, and the same loops run over the tables of the plan. */
#ifdef PH_SMALL
#define PH_SUMS 4
#else
#define PH_SUMS 1
#endif
#if defined(PH_SMALL) && defined(PH_WIDTH)
#undef PH_SMALL
#endif
#ifdef PH_SMALL
#define PH_TABLES(w) (&small_tables)
#define PH_WRITTEN inline __attribute__((always_inline))
#ifdef __clang__
#define PH_UNROLL _Pragma("clang loop unroll(full)")
#define PH_COPY(to, from) memcpy(to, from, sizeof(*(to)) * PH_SMALL);
#else /* gcc keeps in memory what memcpy touches */
#define PH_UNROLL _Pragma("GCC unroll 65534")
#define PH_COPY(to, from)                                                                                    \
    PH_UNROLL                                                                                                \
    for (int i = 0; i < PH_SMALL; i++)                                                                       \
        (to)[i] = (from)[i];
#endif
#define PH_LOCAL(type, name)                                                                                 \
    type name[PH_SMALL + 1];                                                                                 \
    PH_COPY(name, s.name)                                                                                    \
    s.name = name;
#define PH_KEEP(name) PH_COPY(w->name, name)
#else
#define PH_SMALL 0
#define PH_TABLES(w) ((w)->c)
#define PH_WRITTEN inline
#define PH_UNROLL
#define PH_LOCAL(type, name)
#define PH_KEEP(name)
#endif

/* Work space and tables as a sweep sees them. */
static PH_WRITTEN ph_sweep view(const ph_work *w) {
    ph_sweep s = {
        .c = PH_TABLES(w),
        .carry = w->carry,
        .h = w->h,
        .parameters = w->p,
        .point = w->point,
        .velocity = w->velocity,
        .inverse_mass = w->inverse_mass,
        .constant = w->constant,
        .start = w->start,
        .slope = w->slope,
        .input = w->u,
        .base = w->base,
        .multiplier = w->multiplier,
        .f = w->f,
        .x = w->x,
        .v = w->v,
        .n = w->n,
        .force = w->force,
        .next = w->next,
        .slot = w->slot,
        .light_mass = w->light_mass,
        .inverse_light = w->inverse_light,
        .missing = w->missing,
        .row = w->row,
        .stress = w->stress,
        .defect = w->defect,
    };
    memcpy(s.column, w->column, sizeof(s.column));
    return s;
}

/* a[plus] - a[minus]; the entry behind the last degree of freedom is zero. */
static PH_WRITTEN ph_lane difference(const ph_lane *a, int plus, int minus) {
    return PH_SMALL && minus == PH_SMALL ? a[plus] : a[plus] - a[minus];
}

/* Arguments of instance i of a function: numbers, differences of lanes, coordinates of a constraint, a spring
 * or a force. */
#define PH_ROOM(n) ((n) > 0 ? (n) : 1)
#define PH_TAKE(type, name, size, from, table)                                                               \
    type name[PH_ROOM(size)];                                                                                \
    PH_UNROLL                                                                                                \
    for (int j = 0; j < size; j++)                                                                           \
        name[j] = (from)[(table)[i * size + j]];
#define PH_DIFFERENCES(name, size, from, plus, minus)                                                        \
    ph_lane name[PH_ROOM(size)];                                                                             \
    PH_UNROLL                                                                                                \
    for (int j = 0; j < size; j++)                                                                           \
        name[j] = difference(from, (plus)[i * size + j], (minus)[i * size + j]);
#define PH_INNER_DIFFERENCES(name, size, from, plus, minus)                                                  \
    ph_inner name[PH_ROOM(size)];                                                                            \
    PH_UNROLL                                                                                                \
    for (int j = 0; j < size; j++) {                                                                         \
        const int above = (plus)[i * size + j], below = (minus)[i * size + j];                               \
        name[j] = PH_SMALL && below == PH_SMALL ? PH_INNER((from)[above])                                    \
                                                : PH_INNER((from)[above]) - PH_INNER((from)[below]);         \
    }
#define PH_POINTS                                                                                            \
    PH_DIFFERENCES(d, PH_NX, x, plus, minus)                                                                 \
    PH_UNROLL                                                                                                \
    for (int j = 0; j < PH_NX; j++)                                                                          \
        d[j] += PH_SPREAD(point[i * PH_NX + j]);
#define PH_INNER_POINTS                                                                                      \
    PH_INNER_DIFFERENCES(d, PH_NX, x, plus, minus)                                                           \
    PH_UNROLL                                                                                                \
    for (int j = 0; j < PH_NX; j++)                                                                          \
        d[j] += PH_INNER_SPREAD(point[i * PH_NX + j]);

#endif
