/* Signals between members that are sampled where steps meet and held over a step: sampled_signals.py. */
#ifndef PH_HELD_H
#define PH_HELD_H

/* Wires stand in the order in which they are sampled; those of a stage are read before they are written. */
typedef struct ph_held {
    int n;
    int nstage;
    const int *stage;  /* nstage+1: where the wires of each begin */
    const int *source; /* n: a share */
    const int *told;   /* n: place among what that tells */
    const int *target; /* n: a share */
    const int *taken;  /* n: place among what that takes, -1: it is an input of a port */
    const int *input;  /* n: of its nu */
    const double *factor;
    const double *offset;
    const double *low; /* limits of inputs */
    const double *high;
    int extrapolated;
    int known;      /* samples before the last ones are */
    int known_kept; /* as the step began */
    double last;    /* length of the step before */
    double last_kept;
    double *now; /* n: samples */
    double *now_kept;
    double *before;
    double *before_kept;
    double *values; /* n: over the step */
    double *row;    /* a row a step, n: samples at its end */
} ph_held;

#endif
