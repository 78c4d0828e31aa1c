/* A native member: an instance, and what the master works on beside it. */
#ifndef PH_NATIVE_H
#define PH_NATIVE_H

#include "impulses.h"
#include "phfmu.h"

typedef struct ph_native {
    ph_instance *in;
    ph_impulses *kicks; /* NULL: it takes none */
    ph_instance *chain; /* the instance with tangents; NULL: inputs are held */
    int parts;          /* internal steps of a step */
    int exact;          /* 1: a step is taken however short it is */
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
