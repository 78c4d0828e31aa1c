/* Members of a network in compiled code, stepped apart and joined: the co-simulation master. Couplings are
 * solvers of it (ph_solver), the equations of which are in the files in Python of the same names.
 *
 * Members are instances, or units in libraries of their own, many of which may be loaded at once under the
 * same names: each is called through a table of functions.
 *
 * Members that only Python can step are called back (compiled/called_share.py). A step that a member refuses,
 * or whose rows do not converge, ends the call: the members are put back to the start of the step.
 *
 * Unknowns z = (xi at nodes nxi | impulses m at the start nbare | m' at the end nbare), rows (at nodes nxi |
 * at ends nbare | of the impulses nbare). The Python side reads the field lists from here: one field a line.
 */
#ifndef PH_MASTER_H
#define PH_MASTER_H

#include "acceptance.h"
#include "clock.h"
#include "crew.h"
#include "held.h"
#include "phfmu.h"

struct ph_share;

/* What is asked of a member: of a native one (native.c), of a unit (unit.c), or of one in Python. Functions
 * answer a ph_status, or anything else but PH_OK where the member itself can say why it refuses. */
typedef struct ph_kind {
    int (*keep)(const struct ph_share *);                     /* where it is, to come back */
    int (*restore)(const struct ph_share *);                  /* there */
    int (*step)(const struct ph_share *, double t, double h); /* under u and s */
    int (*refresh)(const struct ph_share *);                  /* energies and outputs now */
    int (*jump)(const struct ph_share *);                     /* S now */
    int (*more)(const struct ph_share *);                     /* one more impulse at the end of the step: s */
    int (*along)(const struct ph_share *);              /* dy and dend of the step; else by differences */
    int (*present)(const struct ph_share *);            /* inputs from now on */
    int (*record)(const struct ph_share *, double *to); /* energies and outputs now, a row of the step */
    int (*tell)(const struct ph_share *);               /* held signals that it sends now */
    int (*take)(const struct ph_share *);               /* held signals that it takes from now on */
    void (*forget)(const struct ph_share *);            /* what solves start from; NULL: that is not known */
} ph_kind;

/* A member's part. Its directions are: ninput inputs at nodes, nbare impulses at the start, nbare at the end.
 * Its unknowns and rows have numbers of their own, that of unknown c in z is col[c], that of row r is row[r].
 */
typedef struct ph_share {
    const ph_kind *kind;
    void *of; /* ph_native or ph_unit */
    int nu;
    int k; /* values of each input: its nodes, or 1 where they are held */
    int ncomp;
    int stride; /* of outputs */
    int length; /* of a row of its record */
    int ninput;
    int nkick; /* impulses that it takes if it is at a bare node, else 0 */
    int nbare; /* how many of them are at bare nodes */
    int ncol;
    int nrow;
    int nright;
    int nleft;
    const int *col;             /* ncol */
    const int *row;             /* nrow */
    const int *entry;           /* nrow*ncol: entries of the matrix */
    const int *input;           /* ninput: place of each direction among the k*nu inputs */
    const int *kicked;          /* nbare: place of each among the impulses */
    const int *kicked_output;   /* nbare: and of its output among the nu */
    const int *right_direction; /* nright: direction += value * unknown */
    const int *right_col;       /* nright */
    const double *right;        /* nright */
    const int *left_output;     /* nleft: row += value * output, of k*nu at nodes, then nu at the end */
    const int *left_row;        /* nleft */
    const double *left;         /* nleft */
    const int *jump_entry;      /* nkick*nkick: entry in the blocks of S, or -1 */
    const double *weights;      /* k */
    const double *at_end;       /* k: of the polynomial through values at nodes its value at the end */
    const double *nominal;      /* nu: sizes of inputs */
    double *free;               /* nu: inputs besides those of junctions, offsets of signals */
    const double *given;    /* a row a step, k*nu each: the same at its nodes; NULL: free is what they are */
    const double *outputs;  /* k*stride, of the member */
    const double *energies; /* ncomp, of the member: stored now */
    const double *end;      /* nu, of the member: outputs now */
    double *told;           /* held signals that it sends, as many as its kind knows: work, as all below */
    double *taken;          /* and that it takes, but for ports */
    double *u;              /* k*nu */
    double *now;            /* nu: inputs at the end of the step, where signals feed some */
    double *s;              /* 2*nkick */
    double *y;              /* k*nu + nu */
    double *dy;             /* directions*(k*nu) */
    double *dend;           /* directions*nu */
    double *across;         /* nrow*directions */
    double *jump;           /* nkick*nkick */
    double *record;         /* a row a step */
    ph_clock *clock;        /* NULL: nobody asks */
} ph_share;

struct ph_master;
struct ph_trial;

/* Steps that tell the start, each half of the one before. */
#define PH_START_TRIALS 10

/* How a coupling finds the unknowns z of a step: where it starts from, what members are asked in a trial, and
 * how z moves between trials. NULL: nothing is done; without `move` the first trial is the step. */
typedef struct ph_solver {
    int (*begin)(struct ph_master *);            /* before the first step of a call */
    void (*start)(struct ph_master *, int next); /* z; next: the step goes on from the one before */
    int (*take)(struct ph_master *, double t, double h, int again, struct ph_trial *);
    int (*move)(struct ph_master *, ph_progress *, int left);
    int (*again)(struct ph_master *, int next);  /* the step was refused: z to try again from, or 0 */
    void (*keep)(struct ph_master *, int next);  /* the step was accepted */
    void (*drop)(struct ph_master *);            /* it was refused */
    int (*instant)(struct ph_master *);          /* z where the members are; NULL: by steps */
    void (*forget)(struct ph_master *);          /* the next step goes on from z alone */
    int (*remembered)(const struct ph_master *); /* how many doubles the next step goes on from besides z */
    void (*save)(const struct ph_master *, double *to);
    void (*load)(struct ph_master *, const double *from);
    int (*sound)(const struct ph_master *, const double *from); /* whether `save` can have written them */
    /* z of a step `ratio` times as long as the last one, which was accepted; NULL: constants */
    void (*further)(struct ph_master *, double ratio);
} ph_solver;

typedef struct ph_master {
    const ph_solver *solver;
    void *memory;  /* of the solver: ph_anderson, ph_in_turn, or nothing */
    ph_held *held; /* NULL: there are none */
    const ph_rules *rules;
    const ph_share *shares; /* nshare */
    int nshare;
    int nxi;
    int nbare;
    int ncolumn;
    int nskew;
    int ncluster;
    int nahead;
    int nnz;
    int capacity;
    int nwire;
    int known;              /* rows of missed that are known */
    int row;                /* of the step that is taken */
    int refused;            /* ph_status of the step that was not accepted */
    int ntrial;             /* trials of the last step */
    double time;            /* its start */
    double length;          /* and length */
    int points;             /* of the rule for the root of impulses */
    const double *cosines;  /* points: cos^2 t_l */
    const double *weights;  /* nxi */
    const double *node;     /* nxi: where in the step each unknown is */
    const double *at_end;   /* nxi: the basis of each unknown at the end of the step */
    const double *at_begin; /* nxi: and at its start */
    const double *nominal;  /* ncolumn: sizes of common variables */
    const int *column;      /* nxi: common variable of each unknown */
    const int *bare_column; /* nbare */
    const int *skew_row;    /* nskew: rows at nodes += value * unknown */
    const int *skew_col;    /* nskew */
    const int *skew_entry;  /* nskew */
    const double *skew;     /* nskew */
    const double *least;    /* nxi+nbare: size of a row without terms */
    const int *cluster;     /* ncluster+1: bare columns that S couples, one after the other */
    const int *square;      /* ncluster+1: where the matrix of each begins */
    const int *law_entry;   /* square[ncluster]: entries of the rows of the impulses, columns m */
    const int *own_entry;   /* nbare: the same, columns m' */
    const double *signs;    /* nbare: (-1)^k */
    const int *ahead_to;    /* nahead: next unknown += value * unknown */
    const int *ahead_from;  /* nahead */
    const double *ahead;    /* nahead */
    const int *wire_source; /* nwire: a share; signals in the order in which they follow from each other */
    const int *wire_output; /* nwire: of its nu */
    const int *wire_target; /* nwire: a share */
    const int *wire_input;  /* nwire: of its nu */
    const double *factor;   /* nwire */
    const int *colptr;      /* nz+1 */
    const int *rowind;      /* nnz */
    const int *order;       /* nz */
    const int *prefer;      /* nz */
    double *z;              /* nz: work, as all below, but for found and the factors */
    double *found;          /* nz: of the last accepted step */
    double *missed;         /* PH_COUPLED_KNOWN*nz: what continuations missed, of the last step first */
    double *plain;          /* nz: the continuation */
    double *best;           /* nz: of the trial that left the least */
    double *history;        /* iterations: the scaled residual of each trial */
    double *rows;           /* nz */
    double *size;           /* nz */
    double *move;           /* nz */
    double *a;              /* nnz */
    double *scaled;         /* nnz */
    double *scale;          /* nz */
    double *S0;             /* square[ncluster], as the next three */
    double *S1;
    double *mixed;
    double *T;
    double *moved;   /* nbare: T m */
    double *sums;    /* nbare: of outputs before the step */
    void *lu;        /* ph_lu with room for its parts behind it */
    double *tried;   /* 2*PH_START_TRIALS*ncolumn: estimates of common variables at a start */
    double *xi;      /* a row a step, 2*ncolumn: common variables, means, then at the end */
    double *work;    /* a row a step: energy of each unknown at its junction, nz; NULL: not wanted */
    ph_crew *crew;   /* threads that help, or NULL */
    int *status;     /* nshare: of the parts of members */
    double *cost;    /* nshare: seconds of their steps are added, NULL: nobody asks */
    ph_clock *clock; /* of one thread: seconds of its parts, NULL: nobody asks */
    int *trials;     /* a step each */
    int *accepted;   /* a step each: ph_accepted */
} ph_master;

/* What the rows of a trial leave, in scaled size and in energy, and the energy in play as far as it is known.
 */
typedef struct ph_trial {
    double scaled;
    double left;
    double through;
    double in_play; /* negative: not asked for yet */
} ph_trial;

/* Bytes of the factors of n unknowns. */
PH_API size_t ph_master_lu_size(int n, int nnz, int capacity);
PH_API void ph_master_lu_init(ph_master *m);
/* Steps k = first..first+n-1 from t0 + k h, of which the first starts from z; next: from the continuation of
 * `found`. Returns how many were accepted: fewer than n if one was not, before which the members are then. */
PH_API int ph_master_run(ph_master *m, double t0, double h, int n, long long first, int next);

/* What the next step goes on from besides z: nothing; how many doubles it is; these, and from these; whether
 * they can have been saved. */
PH_API void ph_master_forget(ph_master *m);
PH_API int ph_master_remembered(const ph_master *m);
PH_API void ph_master_save(const ph_master *m, double *to);
PH_API void ph_master_load(ph_master *m, const double *from);
int ph_master_sound(const ph_master *m, const double *from);

/* z of a first step, or of one that is not the continuation of the one before: constants of xi (ncolumn). */
PH_API void ph_master_spread(ph_master *m, const double *xi);
/* start.c: common variables before the first step of length h, where no step has ended: those of the instant
 * (begin), of at most PH_START_TRIALS steps, and the means of a trial step, which is where the first one
 * starts from. With one step begin is mean. guess, mean, begin: ncolumn. The members stay where they are.
 * Steps of xi, trials and accepted are to have room for one row. */
PH_API int ph_master_prepare(ph_master *m, double t0, double h, int steps, const double *guess, double *mean,
                             double *begin);

/* The same of a step that goes on from one of another length. */
PH_API void ph_master_further(ph_master *m, double ratio);

/* The solvers. */
PH_API const ph_solver *ph_solver_newton(void);
PH_API const ph_solver *ph_solver_anderson(void);
PH_API const ph_solver *ph_solver_in_turn(void);

/* master.c: number + 1 of the member that refused, 0: none did. */
int ph_master_refuser(const ph_master *m);
/* All members where they were when the step began, also if one of them cannot be brought back. */
void ph_master_restore(ph_master *m);

/* trial.c: S0 and sums before a step; a trial of all members at once; ph_energy_left of it. */
int ph_trial_before(ph_master *m);
PH_API int ph_trial_take(ph_master *m, double t, double h, int again, ph_trial *found);
int ph_trial_left(ph_master *m, const ph_progress *p, ph_trial *now);
int ph_all_finite(const double *values, int n);

/* interface_matrix.c: derivatives of all rows of the last trial, factored; C alone; those of members as they
 * are, after `along`; move = the update of the unknowns for `rows`; whether rows are rounding. */
int ph_matrix_take(ph_master *m);
int ph_matrix_plain(ph_master *m);
int ph_matrix_of(ph_master *m, int (*along)(ph_master *));
PH_API int ph_matrix_factor(ph_master *m);
void ph_matrix_solve(ph_master *m);
int ph_matrix_at_floor(ph_master *m);

/* settle.c: sums at the end of an accepted step made zero. */
int ph_settle(ph_master *m);

/* present.c: signals at the end of an accepted step. */
int ph_signals_present(ph_master *m);

/* held.c: signals where no step is taken; before a step, and after it; they are those before it again. */
int ph_held_sample(ph_master *m);
int ph_held_before(ph_master *m, double h);
int ph_held_after(ph_master *m, double h, int row);
void ph_held_drop(ph_master *m);

/* work.c: what the accepted trial did at the junctions. */
void ph_work_record(const ph_master *m, double h, int row);

/* Where members step from: where they are, which is kept to come back, what was kept, or where they are. */
typedef enum ph_from { PH_FROM_HERE, PH_FROM_KEPT, PH_GOING_ON } ph_from;

/* shares.c: of all members, by all threads: states kept; steps (of n of them, NULL: of all); end values;
 * these and rows of an accepted step; derivatives. */
int ph_shares_keep(ph_master *m);
int ph_shares_step(ph_master *m, double t, double h, ph_from from, const int *which, int n);
int ph_shares_refresh(ph_master *m);
PH_API int ph_shares_finish(ph_master *m, int row);
int ph_shares_along(ph_master *m);

/* Whether a value that was saved is one of 0..most. */
static inline int ph_counted(double value, int most) {
    return value >= 0.0 && value <= most && value == (int)value;
}

/* Its answer, noted: which member refused is read from there. */
static inline int ph_share_said(ph_master *m, int share, int status) {
    m->status[share] = status;
    return status;
}

/* share.c: of one member its inputs under z, k*nu; its step under z, alone, then what that adds to the rows;
 * its derivatives, alone, then what they add to the matrix; what it adds to S and the sums where it is. */
void ph_share_inputs(const ph_master *m, const ph_share *s, double *u);
int ph_share_step(const ph_master *m, const ph_share *s, double t, double h);
void ph_share_add_rows(ph_master *m, const ph_share *s, double h, double *through);
int ph_share_along(const ph_master *m, const ph_share *s);
void ph_share_across(const ph_share *s);
void ph_share_add_matrix(ph_master *m, const ph_share *s);
int ph_share_more(const ph_master *m, const ph_share *s, const double *more);
int ph_share_before(const ph_share *s, int nxi, double *S, double *sums);
int ph_share_end(const ph_share *s, int nxi, double *sums);

/* native.c, unit.c: the kinds of members. */
PH_API const ph_kind *ph_kind_native(void);
PH_API const ph_kind *ph_kind_unit(void);

/* pair.c: T of r_T and what it makes of m. */
int ph_pair_moved(ph_master *m);
int ph_pair_root(ph_master *m);
/* moved = -S1^-1 of the sums at ends. */
int ph_pair_left(ph_master *m);

#endif
