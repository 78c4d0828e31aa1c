/* Tables of the Schur stepper, the solver of constrained particles (schur.inc), read from this header like
 * those of the plan. */
#ifndef PH_SCHUR_H
#define PH_SCHUR_H

#include <stddef.h>

#include "names.h"

/* Elimination of a symmetric matrix S = sum of products of gradient slots: entries are numbered
 * [n diagonals | columns of L below them] by elimination position. */
typedef struct ph_elimination {
    int n, nentry;
    int full;              /* from this position on columns of L have no gaps, and no lists of updates */
    const int *order;      /* n: position -> row */
    const int *column;     /* n+1: first entry of each column of L */
    const int *below;      /* nentry-n: row of each entry of L */
    const int *update_ptr; /* n+1: updates of each column, entry[target] -= entry[left] entry[right] / d */
    const int *update_target;
    const int *update_left;
    const int *update_right;
    const int *product_ptr;     /* nentry+1: terms of an entry, sign a b / m */
    const int *product_dof;     /* degree of freedom of the mass */
    const int *product_a;       /* gradient slot */
    const int *product_b;       /* gradient slot */
    const double *product_sign; /* 1 or -1 */
} ph_elimination;

/* Kinds of functions of the Schur stepper, in the order of evaluation. */
typedef enum ph_lane_kind {
    PH_LANE_CONSTRAINT, /* gradient and its derivative along v */
    PH_LANE_STRAIN,     /* gradient and stresses */
    PH_LANE_FORCE,      /* forces */
    PH_LANE_START,      /* strain at the start of a step */
    PH_LANE_MASS,       /* inverse mass */
    PH_LANE_LOAD        /* forces that depend on parameters only */
} ph_lane_kind;

/* All instances of one function of the Schur stepper; tables are instance-major, index ndof: nothing. */
typedef struct ph_lane_group {
    int n;         /* instances */
    int kind;      /* ph_lane_kind */
    int first;     /* row of the first instance (constraints, strains) */
    int point;     /* its first coordinate */
    const int *zp; /* rates: degrees of freedom, zm subtracted */
    const int *zm;
    const int *ui; /* inputs */
    const int *pi; /* parameters */
    const int *op; /* results: degrees of freedom, om gets the opposite */
    const int *om;
    const int *until;   /* ntile+1: instances that are evaluated with each tile */
    const int *settled; /* ntile+1: rows whose degrees of freedom are done with it */
} ph_lane_group;

/* Tables of the Schur stepper beside the plan: degree of freedom d has the states position[d] and
 * velocity[d]; a coordinate is the difference of two of them. Rows are constraints, then strains, with the
 * coordinates row_ptr[r].., and one gradient slot for each of them. A tile is a stretch of degrees of freedom
 * that goes through all loops of a sweep while it is in the cache. */
typedef struct ph_schur {
    int k, ndof, nconstraint, nstrain, npoint, ngroup, nload, nlight, ntile;
    const ph_lane_group *groups;
    const int *position;        /* ndof */
    const int *velocity;        /* ndof */
    const double *nominal;      /* ndof: of the velocities */
    const int *w_position;      /* ndof*k: unknowns of the plan */
    const int *w_velocity;      /* ndof*k */
    const int *costate;         /* ndof*k: Y index of the velocity's costate, the one Z is read of */
    const int *w_lambda;        /* nconstraint*k */
    const int *w_mu;            /* nconstraint */
    const int *row_ptr;         /* nconstraint+nstrain+1 */
    const int *point_plus;      /* npoint: degree of freedom */
    const int *point_minus;     /* npoint: the one subtracted, or ndof */
    const int *load_dof;        /* nload: force on it += value times */
    const int *load_kind;       /* nload: input (0) or velocity (1) */
    const int *load_source;     /* nload */
    const double *load_value;   /* nload */
    const int *tile_dof;        /* ntile+1: degrees of freedom that begin with each tile */
    const int *tile_done;       /* ntile+1: those whose forces are complete after it */
    const int *tile_final;      /* ntile+1: those whose rows are */
    const int *tile_load;       /* ntile+1: loads on those that begin with it */
    const int *light;           /* nlight: degrees of freedom without mass, ascending */
    const int *light_place;     /* nlight: elimination position of the row of each in `hard` */
    const ph_elimination *hard; /* constraints */
    const ph_elimination *soft; /* all rows, or NULL: a step with stiff springs is left to Newton */
    const double *extended;     /* (k+1)*k: A, then b */
    const double *multiplier;   /* (k+1)*(k+1): inverse of [A, -1; b, 0] */
    const double *spectrum;     /* k: A^-2 in real block-diagonal form */
    const double *modes;        /* k*k */
    const double *to_modes;     /* k*k */
} ph_schur;

/* The Schur stepper compiled for the lanes of one model; size is NULL where there is none. init lays its work
 * space out in memory of size(plan) bytes aligned for double. solve: from x, u, p and the last unknowns of
 * a system to its new ones; the runs, as bits, for which the sparse Newton has to do it. depend: after a
 * solve, how the constraint whose multipliers are the unknowns rows (k), and which it has left out, depends
 * on the others: at each node the null vector of Dg^T with 1 in its place, into dw at the multipliers. */
struct ph_plan;
struct ph_system;
typedef struct ph_schur_code {
    size_t (*size)(const struct ph_plan *plan);
    void (*init)(void *memory, const struct ph_plan *plan);
    unsigned (*solve)(void *memory, struct ph_system *system, double h);
    int (*depend)(void *memory, struct ph_system *system, const int *rows);
} ph_schur_code;

#endif
