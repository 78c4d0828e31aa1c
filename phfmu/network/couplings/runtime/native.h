/* A native member: functions of its library, and what they work on. */
#ifndef PH_NATIVE_H
#define PH_NATIVE_H

#include "impulses.h"
#include "phfmu.h"

typedef struct ph_calls {
    void (*save)(const ph_instance *, void *);
    int (*load)(ph_instance *, const void *);
    int (*set_input)(ph_instance *, const double *);
    int (*set_node_inputs)(ph_instance *, const double *);
    int (*step_parts)(ph_instance *, double, double, int);
    int (*refresh)(ph_instance *);
    int (*set_parameters)(ph_instance *, const double *);
    const double *(*parameters)(const ph_instance *);
    int (*sensitivity)(ph_instance *, double *);
    int (*step_along)(ph_instance *, const ph_directions *);
    int (*end_along)(ph_instance *, const ph_directions *);
    const double *(*ledger)(const ph_instance *, int);
    int (*set_impulses)(ph_impulses *, const double *);
    int (*step_impulses)(ph_impulses *, double, double, int);
    int (*kick_more)(ph_impulses *, const double *);
    void (*jump)(ph_impulses *, double *);
    void (*impulses_along)(ph_impulses *, int, int, const double *, double *);
} ph_calls;

typedef struct ph_native {
    const ph_calls *calls;
    ph_instance *in;
    ph_impulses *kicks; /* NULL: it takes none */
    const ph_calls *chain_calls;
    ph_instance *chain; /* the instance with tangents; NULL: inputs are held */
    int parts;          /* internal steps of a step */
    int nq;
    int nsignal;
    int width;             /* nx+1+na */
    int impulses;          /* of the model */
    const double *signals; /* nsignal, of the instance */
    double *values;        /* 4*impulses, of the instance: impulses that belong to its state */
    const double *du;      /* directions*(k*nu), unit */
    const double *ds;      /* nbare*nkick, unit */
    const double *ds_end;  /* directions*nkick, zero */
    int np;
    int ntold;
    int ntaken;
    const int *told_first; /* ntold: of the signals, of which so many are added */
    const int *told_count; /* ntold */
    const int *taken;      /* ntaken: of the parameters */
    double *p;             /* np: work */
    double *kept;          /* state at the start of the step: work, as all below */
    double *copied;        /* state for the chain */
    double *kept_values;   /* 4*impulses */
    double *dx;            /* directions*width, or nu*nu */
} ph_native;

#endif
