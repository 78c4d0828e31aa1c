/* Members that step once, in groups one after the other, each under the unknowns of the instant before it. */
#ifndef PH_IN_TURN_H
#define PH_IN_TURN_H

/* Scaled residual that counts as zero at an instant, and where it no longer shrinks; one that shrinks to more
 * than this part of the last needs a new matrix. instant.py reads them from here. */
#define PH_INSTANT_SOLVED 1e-13
#define PH_INSTANT_STALLED 1e-10
#define PH_INSTANT_SHRINKING 0.1
#define PH_INSTANT_ITERATIONS 20

/* Relative change of an input that tells whether outputs follow it, and the part of an output below which a
 * change of it is none. coupled_members.py reads them from here. */
#define PH_INSTANT_MOVE 1e-3
#define PH_INSTANT_ROUNDING 1e-13

/* How a member is: with other inputs than those that are told of it, with these, or with outputs that are
 * read under them. */
typedef enum ph_asked { PH_UNGIVEN, PH_GIVEN, PH_ASKED } ph_asked;

/* Rows, shares and blocks that have to be looked at are marked, each once: their number, a list, and whether
 * each is in it. */
typedef struct ph_in_turn {
    int ngroup;
    const int *group;       /* ngroup+1: where the members of each begin */
    const int *member;      /* nshare: in the order in which they step */
    const int *term;        /* nxi+1: where the outputs begin that each row is a sum of */
    const int *term_share;  /* of a share */
    const int *term_output; /* of its nu */
    const double *term_value;
    const int *skew;       /* nxi+1: where the unknowns begin that it is a sum of */
    const int *skew_entry; /* numbers of them among those of the master */
    const int *fed;        /* nxi+1: where the shares begin that each unknown feeds */
    const int *fed_share;
    int begun; /* the matrix is factored; work, as all below */
    int nrow;
    int nshare;
    int nblock;
    int *asked; /* nshare: ph_asked */
    int *row;
    int *row_marked; /* nxi */
    int *share;
    int *share_marked; /* nshare */
    int *block;
    int *block_marked; /* nxi */
    int *label;        /* 2*nxi: of rows, then of unknowns, the block of the matrix */
    int *first;        /* nxi+1: where the steps of elimination of each block begin */
    int *step;         /* nxi */
    double *used;      /* nxi: unknowns that members have taken */
    double *base;      /* outputs of a member, as many as any has */
} ph_in_turn;

#endif
