/* See books.h. */
#include "books.h"

#include <string.h>

enum { RUNS = sizeof(ph_real) / sizeof(double) };

/* Number l of each. */
static void place(ph_real *to, int l, const double *from, int n) {
    double *each = (double *)to + l;
    for (int k = 0; k < n; k++)
        each[(ptrdiff_t)k * RUNS] = from[k];
}

/* total += x, compensated by what the additions before have lost. */
static void add_to(ph_real *total, ph_real *carry, ph_real x) {
    const ph_real part = x + *carry, sum = *total + part;
    *carry = part - (sum - *total);
    *total = sum;
}

void ph_books_open(const ph_books *b, double *const *row) {
    ph_accounts *a = b->accounts;
    memset(b->books, 0, sizeof(ph_real) * (size_t)b->nbook);
    a->violated = a->worst_unexplained = PH_REAL_SPREAD(0.0);
    a->H0 = b->was;
    a->H = b->now;
    a->varying = b->varying;
    a->stored = (const ph_real *)row[PH_ROW_STORED];
    a->dissipated = (const ph_real *)row[PH_ROW_DISSIPATED];
    a->supplied = (const ph_real *)row[PH_ROW_SUPPLIED];
    a->numerical = b->loses ? (const ph_real *)row[PH_ROW_NUMERICAL] : NULL;
    a->moved = (const ph_real *)row[PH_ROW_MOVED];
    a->pairs = (const ph_real *)row[PH_ROW_PAIRS];
}

void ph_books_constant(const ph_books *b, int l, const double *values) {
    place(b->constant, l, values, b->ncomp);
}

void ph_books_stored(const ph_books *b, int l, const double *energy) {
    double *carry = (double *)b->carry + l;
    place(b->now, l, energy, b->ncomp);
    place(b->accounts->before, l, energy, b->ncomp);
    for (int k = 0; k < b->ncomp; k++)
        carry[(ptrdiff_t)k * RUNS] = 0.0;
}

static ph_real smaller(ph_real a, ph_real b) {
    return PH_REAL_WHERE(b < a, b, a);
}

static ph_real larger_of(ph_real a, ph_real b) {
    return PH_REAL_WHERE(b > a, b, a);
}

void ph_books_step(const ph_books *b) {
    ph_accounts *a = b->accounts;
    memcpy(b->was, b->now, sizeof(ph_real) * (size_t)b->ncomp);
    for (int k = 0; k < b->ncomp; k++) {
        const ph_real c = b->constant[k], was = b->was[k];
        add_to(&b->now[k], &b->carry[k], a->stored[k]);
        b->varying[k] = smaller(larger_of(PH_REAL_ABS(was), PH_REAL_ABS(b->now[k])),
                                larger_of(PH_REAL_ABS(was - c), PH_REAL_ABS(b->now[k] - c)));
    }
    (void)ph_account(a, 0);
    memcpy(a->before, b->now, sizeof(ph_real) * (size_t)b->ncomp);
}

void ph_books_shares(const ph_books *b, double *out) {
    const ph_real share = ph_worst_share(b->accounts);
    memcpy(out, &share, sizeof(share));
}
