/* The ledger of a sweep's runs, booked and judged step by step: of one run, or, compiled for these (real.h),
 * of those whose steps are taken side by side. The Python side reads the fields: one a line. */
#ifndef PH_BOOKS_H
#define PH_BOOKS_H

#include "ordinary.h"
#include "phfmu.h"

typedef struct ph_books {
    int ncomp;
    int nbook;
    int loses;             /* whether the scheme has a numerical loss */
    ph_accounts *accounts; /* as a run has them, */
    ph_real *books;        /* nbook: and all that they add up */
    ph_real *constant;     /* ncomp, as are all of the next: what of H is constant */
    ph_real *was;          /* stored energy at the start of the step, */
    ph_real *now;          /* at its end, */
    ph_real *carry;        /* and what its sum has lost to rounding */
    ph_real *varying;      /* the larger of both, without what is constant if that is less */
} ph_books;

#define PH_BOOKS(name)                                                                                       \
    /* Nothing is booked yet; row: where the ledger of a step is, PH_NROW arrays. */                         \
    void name##_open(const ph_books *b, double *const *row);                                                 \
    /* What of H is constant [ncomp] in run l of them. */                                                    \
    void name##_constant(const ph_books *b, int l, const double *values);                                    \
    /* Stored energy [ncomp] of run l at the start, and where parameters changed it. */                      \
    void name##_stored(const ph_books *b, int l, const double *energy);                                      \
    /* Books the last step. H is what its changes add up to, so that it is not solved for. */                \
    void name##_step(const ph_books *b);                                                                     \
    /* See ph_worst_share; of each run. */                                                                   \
    void name##_shares(const ph_books *b, double *out);

PH_BOOKS(ph_books)
PH_BOOKS(ph_wide_books)

#endif
