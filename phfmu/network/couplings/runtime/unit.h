/* A member that is a unit of this package: the functions of its library that the standard has, and the
 * variables that it exchanges through them. Nothing else of the unit is used. */
#ifndef PH_UNIT_H
#define PH_UNIT_H

#include <stdbool.h>

#include "phfmu.h"

/* What the library of a unit has, by the names of the standard less its version. */
typedef struct ph_fmi2 {
    int (*SetReal)(void *, const unsigned *, size_t, const double *);
    int (*GetReal)(void *, const unsigned *, size_t, double *);
    int (*DoStep)(void *, double, double, int);
    int (*GetFMUstate)(void *, void **);
    int (*SetFMUstate)(void *, void *);
    int (*GetDirectionalDerivative)(void *, const unsigned *, size_t, const unsigned *, size_t,
                                    const double *, double *);
} ph_fmi2;

typedef struct ph_fmi3 {
    int (*SetFloat64)(void *, const unsigned *, size_t, const double *, size_t);
    int (*GetFloat64)(void *, const unsigned *, size_t, double *, size_t);
    int (*DoStep)(void *, double, double, bool, bool *, bool *, bool *, double *);
    int (*GetFMUState)(void *, void **);
    int (*SetFMUState)(void *, void *);
    int (*GetDirectionalDerivative)(void *, const unsigned *, size_t, const unsigned *, size_t,
                                    const double *, size_t, double *, size_t);
} ph_fmi3;

/* Scalars that one call sets or reads. Scalar i is value[place[i]], and number at[i] of an array of the
 * member, where it is sign[i] times as large. */
typedef struct ph_scalars {
    const unsigned *reference; /* nreference */
    int nreference;
    int nvalue;
    int n;
    const int *place;   /* n */
    const int *at;      /* n */
    const double *sign; /* n */
    double *value;      /* nvalue */
} ph_scalars;

struct ph_unit;

/* The calls of a version; they answer PH_OK, or PH_REFUSED with what was answered. */
typedef struct ph_version {
    int (*set)(struct ph_unit *, const ph_scalars *);
    int (*get)(struct ph_unit *, const ph_scalars *);
    int (*step)(struct ph_unit *, double t, double h);
    int (*save)(struct ph_unit *);
    int (*restore)(struct ph_unit *);
    int (*derivative)(struct ph_unit *, const ph_scalars *unknown, const ph_scalars *known);
} ph_version;

typedef struct ph_unit {
    const ph_version *version;
    const void *functions; /* ph_fmi2 or ph_fmi3 */
    void *instance;
    void *state;               /* the place of a saved state of it */
    const ph_scalars *input;   /* at the nodes of the coming step, or held over it; of k*nu */
    const ph_scalars *held;    /* from now on; of nu */
    const ph_scalars *impulse; /* of 2*nkick; NULL: it takes none */
    const ph_scalars *output;  /* of the last step; of k*nu */
    const ph_scalars *present; /* of nu outputs now, then stored energy */
    const ph_scalars *jump;    /* the lower triangle, of nkick*nkick; NULL as above */
    const ph_scalars *told;    /* held signals that it sends */
    const ph_scalars *taken;   /* and takes */
    const ph_scalars *row;     /* what is recorded; of nrow */
    const ph_scalars *unknown; /* of k*nu outputs of the step, then nu at its end */
    const ph_scalars *known;   /* one for each direction, of which value is one */
    int nrow;
    double *y;        /* k*nu: work, as all below */
    double *now;      /* nu+1: present */
    double *impulses; /* 2*nkick: of the last step */
    int no_set_prior; /* what steps are told: whether no state of a time before them is restored */
    double time;      /* of the call, the start of the last step */
    double length;    /* of it */
    int answer;       /* fmi2Status, fmi3Status of the last call that was refused */
    const char *call; /* that is under way, NULL between calls */
    const char *refused;
} ph_unit;

/* What is asked again from Python, which says why not. */
enum { PH_REFUSED = PH_UNIT };

/* unit_call.c: around each call. A unit that met a fatal error is not called any more. */
int ph_unit_begin(ph_unit *u, const char *call);
int ph_unit_answer(ph_unit *u, int status);
int ph_unit_dead(const ph_unit *u); /* whether it met a fatal error */

PH_API const ph_version *ph_unit_fmi2(void);
PH_API const ph_version *ph_unit_fmi3(void);

#endif
