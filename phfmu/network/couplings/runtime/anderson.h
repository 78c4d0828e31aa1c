/* Anderson's acceleration of the fixed point xi - M^-1 r(xi), which is in anderson.py; both read the numbers
 * from here. */
#ifndef PH_ANDERSON_H
#define PH_ANDERSON_H

/* Differences kept. */
#define PH_ANDERSON_WINDOW 24

/* Of f is taken while there are no differences and M is C. */
#define PH_ANDERSON_FIRST 0.1

/* Of the nominal of an unknown, its size before the first trial. */
#define PH_ANDERSON_SIZE 1e-6

/* Part of a column that is not in those before it, below which it is rounding. */
#define PH_ANDERSON_DROPPED 1e-12

/* Part of a column's length, below which what is left of it is not orthogonal yet. */
#define PH_ANDERSON_TWICE 0.5

#define PH_ANDERSON_ITERATIONS 60

/* A ring of differences: the one that is j steps older than the newest is row (newest + j) % room. A step
 * adds PH_ANDERSON_ITERATIONS at most, so that none of those before it is lost where it is refused. */
typedef struct ph_anderson {
    int plain; /* M is C */
    int most;  /* differences that are used */
    int room;  /* rows of X and F: most + PH_ANDERSON_ITERATIONS */
    int begun; /* M is factored */
    int count;
    int newest;
    int count_before; /* as the step began */
    int newest_before;
    double *X;           /* room*n: of xi */
    double *F;           /* room*n: of f */
    double *size;        /* n: of the unknowns */
    double *size_before; /* n: as the step began */
    double *from;        /* n: unknowns as the step began */
    double *xi;          /* n: of the last trial */
    double *f;           /* n: of the last trial */
    double *Q;           /* most*n */
    double *R;           /* most*most */
    double *c;           /* most */
    double *inverse;     /* n: of the sizes; work */
    int *kept;           /* most: differences that are more than rounding */
} ph_anderson;

#endif
