/* See ordinary.h. */
#include "ordinary.h"

#include "judge.h"
#include "sums.h"

typedef ptrdiff_t size;

#define ULPS (PH_ULPS * DBL_EPSILON)

/* A sum over a row, compensated. */
typedef struct {
    ph_real high, low;
} across;

/* Of one row: by component, by junction, of the network. */
typedef struct {
    ph_real *through, *played, *residual, *in_play, *H, *allowed, *in_step;
    ph_real *made, *made_low, *moved, *moved_low, *lost, *divided, *created;
    across dH, dissipated, numerical, external;
    ph_real pairs, reach, energy;
} ph_row;

static void add(ph_sums s, size j, ph_real x) {
    const ph_real before = s.high[j], after = before + x;
    s.low[j] += ph_rounded_off(before, x, after);
    s.high[j] = after;
}

static void more(across *s, ph_real x) {
    const ph_real before = s->high;
    s->high += x;
    s->low += ph_rounded_off(before, x, s->high);
}

static ph_real value(across s) {
    return s.high + s.low;
}

static ph_row begun(const ph_accounts *b) {
    const size c = b->c, m = b->junctions;
    ph_real *s = b->scratch, *j = s + 7 * c;
    for (size i = 0; i < 7 * (c + m); i++)
        s[i] = PH_REAL_SPREAD(0.0);
    return (ph_row){.through = s,
                    .played = s + c,
                    .residual = s + 2 * c,
                    .in_play = s + 3 * c,
                    .H = s + 4 * c,
                    .allowed = s + 5 * c,
                    .in_step = s + 6 * c,
                    .made = j,
                    .made_low = j + m,
                    .moved = j + 2 * m,
                    .moved_low = j + 3 * m,
                    .lost = j + 4 * m,
                    .divided = j + 5 * m,
                    .created = j + 6 * m};
}

/* Energies through the port pairs: by port, component and junction. */
static void take_pairs(const ph_accounts *b, const ph_real *pairs, ph_row *r) {
    const ph_sums made = {r->made, r->made_low}, moved = {r->moved, r->moved_low};
    for (size j = 0; j < b->q; j++) {
        const ph_real x = pairs[j], a = PH_REAL_ABS(x);
        add(b->of_port, b->port[j], x);
        r->pairs += a;
        if (b->owner[j] >= 0) {
            r->through[b->owner[j]] += x;
            r->played[b->owner[j]] += a;
        }
        if (b->junction[j] >= 0) {
            add(made, b->junction[j], x);
            add(moved, b->junction[j], a);
        }
        if (b->outside[j] != 0.0)
            more(&r->external, x * b->outside[j]);
    }
}

/* Sums of the components of row i, their residuals and the energies in play. */
static void take_components(const ph_accounts *b, size i, ph_row *r) {
    for (size k = 0; k < b->c; k++) {
        const size at = i * b->c + k;
        const ph_real stored = b->stored[at], dissipated = b->dissipated[at], supplied = b->supplied[at];
        const ph_real gone = b->numerical ? b->numerical[at] : PH_REAL_SPREAD(0.0);
        r->H[k] = ph_most(PH_REAL_ABS(b->H0[at]), PH_REAL_ABS(b->H[at]));
        r->residual[k] = stored + dissipated + gone - supplied;
        const ph_real inside = b->moved ? b->moved[at] : b->varying[at];
        r->in_play[k] = ph_in_play(inside, stored, supplied, dissipated, gone, r->played[k]);
        b->stirred[k] = ph_most(b->stirred[k], ph_most(PH_REAL_ABS(inside), PH_REAL_ABS(stored)));
        add(b->of_dissipated, k, dissipated);
        add(b->of_supplied, k, supplied);
        add(b->of_stored, k, stored);
        add(b->gross, k, r->played[k]);
        more(&r->dH, stored);
        more(&r->dissipated, dissipated);
        if (b->numerical) {
            add(b->of_numerical, k, gone);
            more(&r->numerical, gone);
        }
        const ph_real sum = PH_REAL_ABS(b->of_stored.high[k] + b->of_stored.low[k]);
        b->reach[k] = ph_most(b->reach[k], ph_most(r->in_play[k], sum));
        b->largest[k] = ph_most(b->largest[k], r->H[k]);
        b->turnover[k] += b->moved ? PH_REAL_ABS(b->moved[at]) : PH_REAL_SPREAD(0.0);
        r->reach += b->reach[k];
        r->energy += b->varying[at];
    }
}

/* Whether |x| is allowed; if not, its share is kept. */
static ph_truth within(ph_accounts *b, ph_real x, ph_real allowed) {
    const ph_real share = ph_share(x, allowed);
    const ph_truth fits = PH_REAL_ABS(x) <= allowed;
    b->violated = PH_REAL_WHERE(PH_NOT(fits) & PH_NOT(share <= b->violated), share, b->violated);
    return fits;
}

/* Whether all components of row i close; which was the worst, if one was worse than before. */
static ph_truth judge_components(ph_accounts *b, size i, const ph_row *r) {
    ph_truth fine = PH_TRUE;
    for (size k = 0; k < b->c; k++) {
        const size at = i * b->c + k;
        const ph_real dissipated = b->dissipated[at], supplied = b->supplied[at],
                      residual = PH_REAL_ABS(r->residual[k]);
        const ph_real relation = PH_REAL_WHERE(b->stirred[k] == 0.0, r->reach, PH_REAL_SPREAD(0.0));
        const ph_real in_step = ph_allowed(b->rtol, r->in_play[k], b->reach[k], PH_REAL_SPREAD(0.0));
        const ph_real allowed = ph_allowed(b->rtol, r->in_play[k], b->reach[k], b->varying[at] + relation);
        const ph_real permitted = in_step + ph_rounding_of_H(b->largest[k], b->turnover[k]);
        const ph_real between = b->H0[at] - (i ? b->H[at - b->c] : b->before[k]);
        const ph_real changed = b->H[at] - b->H0[at] - b->stored[at];
        if (b->judged[k]) {
            fine &= residual <= allowed;
            fine &= within(b, PH_REAL_WHERE(dissipated < 0.0, dissipated, PH_REAL_SPREAD(0.0)), allowed);
            fine &= within(b, supplied - r->through[k], allowed);
        }
        fine &= within(b, between, permitted) & within(b, changed, permitted);
        fine &= (allowed > 0.0) | (residual == 0.0);
        const ph_real found = ph_share(residual, allowed);
        const ph_truth worse = found > b->worst[k];
        b->worst[k] = PH_REAL_WHERE(worse, found, b->worst[k]);
        b->worst_residual[k] = PH_REAL_WHERE(worse, r->residual[k], b->worst_residual[k]);
#ifndef PH_WIDTH /* those of several runs are not told */
        if (worse)
            b->worst_row[k] = i;
#endif
        add(b->gap, k, between + changed);
        add(b->missed, k, r->residual[k]);
        add(b->squares, k, allowed * allowed);
        r->allowed[k] = b->judged[k] ? allowed : residual;
    }
    return fine;
}

/* Parts of the energies of the junctions. */
static void take_parts(const ph_accounts *b, const ph_real *works, const ph_row *r) {
    for (size j = 0; j < b->parts; j++) {
        const size at = b->part_junction[j];
        add(b->of_part, j, works[j]);
        b->worst_part[j] = ph_most(b->worst_part[j], PH_REAL_ABS(works[j]));
        r->divided[at] += works[j];
        if (b->projection[j])
            r->lost[at] = PH_REAL_WHERE(works[j] < 0.0, r->lost[at] + works[j], r->lost[at]);
    }
}

/* Whether the junctions made what they may; `made`: by all of them. */
static ph_truth take_junctions(const ph_accounts *b, const ph_row *r, across *made) {
    ph_truth fine = PH_TRUE;
    for (size j = 0; j < b->junctions; j++) {
        const ph_real created = r->made[j] + r->made_low[j];
        const ph_real exchanged = 0.5 * (r->moved[j] + r->moved_low[j]), passed = 2.0 * exchanged;
        b->passed[j] = ph_most(b->passed[j], passed);
        const ph_real rounding = ULPS * r->reach + ULPS * ULPS * r->energy;
        const ph_real permitted = ph_allowed(b->rtol, passed, b->passed[j], PH_REAL_SPREAD(0.0)) + rounding;
        fine &= b->loose ? PH_TRUE : PH_REAL_ABS(created - r->lost[j]) <= permitted;
        r->lost[j] = permitted;
        r->created[j] = created;
        add(b->of_junction, j, created);
        add(b->exchanged, j, exchanged);
        add(b->created, j, PH_REAL_ABS(created));
        b->worst_junction[j] = ph_most(b->worst_junction[j], PH_REAL_ABS(created));
        more(made, created);
    }
    for (size j = 0; j < b->parts; j++) {
        const size at = b->part_junction[j];
        fine &= PH_REAL_ABS(r->created[at] - r->divided[at]) <= r->lost[at];
    }
    return fine;
}

/* Sums of the network; whether it closes. */
static ph_truth take_network(ph_accounts *b, const ph_row *r, across made) {
    ph_real missed = PH_REAL_SPREAD(0.0);
    for (size k = 0; k < b->c; k++)
        missed += r->allowed[k];
    const ph_real dH = value(r->dH), dissipated = value(r->dissipated), numerical = value(r->numerical);
    const ph_real left = dH + dissipated + numerical - value(r->external) - value(made);
    add(b->dH, 0, dH);
    add(b->dissipation, 0, dissipated);
    add(b->loss, 0, numerical);
    add(b->external, 0, value(r->external));
    add(b->residual, 0, value(made));
    add(b->unexplained, 0, left);
    const ph_real permitted = missed + ULPS * r->pairs;
    add(b->left, 0, permitted * permitted);
    b->worst_unexplained = ph_most(b->worst_unexplained, PH_REAL_ABS(left));
    return PH_REAL_ABS(left) <= permitted;
}

ph_truth ph_account(ph_accounts *b, size i) {
    ph_row r = begun(b);
    across made = {PH_REAL_SPREAD(0.0), PH_REAL_SPREAD(0.0)};
    ph_truth fine;
    take_pairs(b, b->pairs + i * b->q, &r);
    take_components(b, i, &r);
    if (b->parts)
        take_parts(b, b->works + i * b->parts, &r);
    fine = judge_components(b, i, &r);
    fine &= take_junctions(b, &r, &made);
    return fine & take_network(b, &r, made);
}

ph_real ph_worst_share(const ph_accounts *b) {
    ph_real most = b->violated;
    for (size k = 0; k < b->c; k++) {
        const ph_real missed = b->missed.high[k] + b->missed.low[k];
        const ph_real squares = b->squares.high[k] + b->squares.low[k];
        const ph_real in_run = ph_share(missed, ph_allowed_in_run(squares));
        most = PH_REAL_WHERE(PH_NOT(b->worst[k] <= most), b->worst[k], most);
        most = PH_REAL_WHERE(PH_NOT(in_run <= most), in_run, most);
    }
    return most;
}

#ifndef PH_WIDTH
static int finite(ph_sums s, size n) {
    for (size i = 0; i < n; i++)
        if (!isfinite(s.high[i]) || !isfinite(s.low[i]))
            return 0;
    return 1;
}

/* 1, or 0 where a row is not ordinary: then the sums are not to be used. */
PH_API int ph_ordinary(ph_accounts *b, size ports) {
    for (size i = 0; i < b->n; i++)
        if (!ph_account(b, i))
            return 0;
    return finite(b->of_dissipated, b->c) && finite(b->of_supplied, b->c) && finite(b->of_stored, b->c) &&
           (!b->numerical || finite(b->of_numerical, b->c)) && finite(b->gap, b->c) &&
           finite(b->missed, b->c) && finite(b->squares, b->c) && finite(b->of_port, ports) &&
           finite(b->exchanged, b->junctions) && finite(b->of_part, b->parts) && finite(b->unexplained, 1) &&
           finite(b->left, 1) && finite(b->dH, 1) && finite(b->dissipation, 1) && finite(b->external, 1);
}
#endif
