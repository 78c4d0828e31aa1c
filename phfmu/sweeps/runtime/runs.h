#ifndef PH_RUNS_H
#define PH_RUNS_H

#include "books.h"
#include <stddef.h>

/* Beside those of ph_status: the start violates a hidden constraint. */
#define PH_RUNS_INCONSISTENT -1
#define PH_RUNS_STOPPED -2

/* The place of the value of a column. */
typedef struct ph_runs_place {
    int kind;
    int index;
    int column;
} ph_runs_place;

/* A value that an event sets. */
typedef struct ph_runs_change {
    int kind;
    int index;
    double value;
} ph_runs_change;

/* Steps first..first+n-1 of the grid t + k h, after the changes from `change` to `until`; inside: free inputs
 * change between equal steps, and what holds at the present time is not asked for. */
typedef struct ph_runs_stretch {
    double t;
    double h;
    int first;
    int n;
    int change;
    int until;
    int inside;
} ph_runs_stretch;

/* Sum of `count` signals from `first` on. */
typedef struct ph_runs_measure {
    int kind;
    int first;
    int count;
} ph_runs_measure;

typedef struct ph_runs {
    ph_instance *in;
    int np;
    int nx;
    int nu;
    int ncomp;
    int nplace;
    int nstretch;
    int nmeasure;
    int ncheck;
    int check;   /* first of the checked signals */
    int energy;  /* first of the stored energies among the signals */
    int refresh; /* whether values of the present time are measured that take a solve in every step */
    double t0;
    double length;
    const double *p0;
    const double *x0;
    const double *u0;
    const double *tolerance; /* ncheck */
    const ph_runs_place *places;
    const ph_runs_stretch *stretches;
    const ph_runs_change *changes;
    const ph_runs_measure *measures;
    const int *stop;       /* 1 from when on no step is wanted any more, by whoever waits for the runs */
    double *p;             /* np, what the instance has */
    double *x;             /* nx */
    double *u;             /* nu */
    double *value;         /* nmeasure, as are the next two: sums and extremes, */
    double *held;          /* the last value, */
    double *time;          /* the time of the extreme */
    const ph_books *books; /* of this run alone */
} ph_runs;

/* Runs of n rows of values, with what of H is then constant [n*ncomp], `many` at a time, each with a
 * structure of its own; lanes: steps them together, or NULL. Per run its status, the measures, and the steps
 * and the worst ratio of what the ledger misses to what is allowed. Ends with those at a time of which one
 * fails; how many runs were taken. */
PH_API int ph_runs_take(const ph_runs *const *s, int many, void *lanes, const double *rows, int width,
                        const double *constants, int n, double *out, double *facts, int *status);

#endif
