/* Rows of a ledger summed and judged in one pass, as booked_steps.py, run_sums.py and judge.py do by arrays,
 * with the same bits.
 *
 * Only for ordinary rows: all numbers finite, all energies within what is allowed.  The first row that is not
 * ends the pass, and the caller takes the whole block by arrays, which know what to say of it. */
#include "judge.h"
#include "sums.h"

typedef ptrdiff_t size;

#define ULPS (PH_ULPS * DBL_EPSILON)

/* Sums high + low of any number of terms. */
typedef struct {
    double *high, *low;
} ph_sums;

/* n rows of c components, q port pairs, of junctions and parts of their energies.  [..] lengths; all owned by
 * the caller. In, by rows: H0 .. varying; numerical, moved and works may be NULL.  In, of the booking: judged
 * [c] or 0; owner [q]: component, or -1; port [q]: of a pair; junction [q]: or -1; outside [q]: sign of what
 * enters the balance, or 0; part_junction [parts]; projection [parts]: it is a loss.  before [c]: H booked at
 * the start. In and out, up to the last row: the sums; reach, largest, stirred [c], passed [junctions]: most
 * so far; turnover [c]: sum of moved; worst [c], with the row and residual of it, the row -1 for none of
 * these; worst_junction [junctions], worst_part [parts].  scratch [7c + 7 junctions]. */
typedef struct {
    size n, c, q, junctions, parts, loose;
    double rtol;
    const double *H0, *H, *stored, *dissipated, *supplied, *numerical, *moved, *pairs, *works;
    const double *varying;
    const size *judged, *owner, *port, *junction;
    const double *outside;
    const size *part_junction, *projection;
    const double *before;
    ph_sums of_dissipated, of_supplied, of_numerical, of_stored, gap, missed, squares; /* [c] */
    ph_sums of_port, of_junction, exchanged, of_part;                     /* [ports], [junctions], [parts] */
    ph_sums dissipation, external, residual, unexplained, dH, loss, left; /* [1] of the network */
    double *reach, *largest, *stirred, *turnover, *passed;
    double *worst, *worst_residual;
    size *worst_row;
    double *worst_junction, *worst_part, worst_unexplained;
    double *scratch;
} ph_ledger;

/* A sum over a row, compensated. */
typedef struct {
    double high, low;
} across;

/* Of one row: by component, by junction, of the network. */
typedef struct {
    double *through, *played, *residual, *in_play, *H, *allowed, *in_step;
    double *made, *made_low, *moved, *moved_low, *lost, *divided, *created;
    across dH, dissipated, numerical, external;
    double pairs, reach, energy;
} ph_row;

static void add(ph_sums s, size j, double x) {
    const double before = s.high[j], after = before + x;
    s.low[j] += ph_rounded_off(before, x, after);
    s.high[j] = after;
}

static void more(across *s, double x) {
    const double before = s->high;
    s->high += x;
    s->low += ph_rounded_off(before, x, s->high);
}

static double value(across s) {
    return s.high + s.low;
}

static ph_row begun(const ph_ledger *b) {
    const size c = b->c, m = b->junctions;
    double *s = b->scratch, *j = s + 7 * c;
    for (size i = 0; i < 7 * (c + m); i++)
        s[i] = 0.0;
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
static void take_pairs(const ph_ledger *b, const double *pairs, ph_row *r) {
    const ph_sums made = {r->made, r->made_low}, moved = {r->moved, r->moved_low};
    for (size j = 0; j < b->q; j++) {
        const double x = pairs[j], a = fabs(x);
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
static void take_components(const ph_ledger *b, size i, ph_row *r) {
    for (size k = 0; k < b->c; k++) {
        const size at = i * b->c + k;
        const double stored = b->stored[at], dissipated = b->dissipated[at], supplied = b->supplied[at];
        const double gone = b->numerical ? b->numerical[at] : 0.0;
        r->H[k] = ph_most(fabs(b->H0[at]), fabs(b->H[at]));
        r->residual[k] = stored + dissipated + gone - supplied;
        const double inside = b->moved ? b->moved[at] : b->varying[at];
        r->in_play[k] = ph_in_play(inside, stored, supplied, dissipated, gone, r->played[k]);
        b->stirred[k] = ph_most(b->stirred[k], ph_most(fabs(inside), fabs(stored)));
        add(b->of_dissipated, k, dissipated);
        add(b->of_supplied, k, supplied);
        add(b->of_stored, k, stored);
        more(&r->dH, stored);
        more(&r->dissipated, dissipated);
        if (b->numerical) {
            add(b->of_numerical, k, gone);
            more(&r->numerical, gone);
        }
        const double sum = fabs(b->of_stored.high[k] + b->of_stored.low[k]);
        b->reach[k] = ph_most(b->reach[k], ph_most(r->in_play[k], sum));
        b->largest[k] = ph_most(b->largest[k], r->H[k]);
        b->turnover[k] += b->moved ? fabs(b->moved[at]) : 0.0;
        r->reach += b->reach[k];
        r->energy += b->varying[at];
    }
}

/* Whether all components of row i close; which was the worst, if one was worse than before. */
static int judge_components(const ph_ledger *b, size i, const ph_row *r) {
    int fine = 1;
    for (size k = 0; k < b->c; k++) {
        const size at = i * b->c + k;
        const double dissipated = b->dissipated[at], supplied = b->supplied[at],
                     residual = fabs(r->residual[k]);
        const double relation = b->stirred[k] == 0.0 ? r->reach : 0.0;
        const double in_step = ph_allowed(b->rtol, r->in_play[k], b->reach[k], 0.0);
        const double allowed = ph_allowed(b->rtol, r->in_play[k], b->reach[k], b->varying[at] + relation);
        const double permitted = in_step + ph_rounding_of_H(b->largest[k], b->turnover[k]);
        const double between = b->H0[at] - (i ? b->H[at - b->c] : b->before[k]);
        const double within = b->H[at] - b->H0[at] - b->stored[at];
        if (b->judged[k])
            fine &=
                residual <= allowed && -dissipated <= allowed && fabs(supplied - r->through[k]) <= allowed;
        fine &= fabs(between) <= permitted && fabs(within) <= permitted && (allowed > 0.0 || residual == 0.0);
        const double found = ph_share(residual, allowed);
        if (found > b->worst[k]) {
            b->worst[k] = found;
            b->worst_residual[k] = r->residual[k];
            b->worst_row[k] = i;
        }
        add(b->gap, k, between + within);
        add(b->missed, k, r->residual[k]);
        add(b->squares, k, allowed * allowed);
        r->allowed[k] = b->judged[k] ? allowed : residual;
    }
    return fine;
}

/* Parts of the energies of the junctions. */
static void take_parts(const ph_ledger *b, const double *works, const ph_row *r) {
    for (size j = 0; j < b->parts; j++) {
        const size at = b->part_junction[j];
        add(b->of_part, j, works[j]);
        b->worst_part[j] = ph_most(b->worst_part[j], fabs(works[j]));
        r->divided[at] += works[j];
        if (b->projection[j] && works[j] < 0.0)
            r->lost[at] += works[j];
    }
}

/* Whether the junctions made what they may; `made`: by all of them. */
static int take_junctions(const ph_ledger *b, const ph_row *r, across *made) {
    int fine = 1;
    for (size j = 0; j < b->junctions; j++) {
        const double created = r->made[j] + r->made_low[j];
        const double exchanged = 0.5 * (r->moved[j] + r->moved_low[j]), passed = 2.0 * exchanged;
        b->passed[j] = ph_most(b->passed[j], passed);
        const double rounding = ULPS * r->reach + ULPS * ULPS * r->energy;
        const double permitted = ph_allowed(b->rtol, passed, b->passed[j], 0.0) + rounding;
        fine &= b->loose || fabs(created - r->lost[j]) <= permitted;
        r->lost[j] = permitted;
        r->created[j] = created;
        add(b->of_junction, j, created);
        add(b->exchanged, j, exchanged);
        b->worst_junction[j] = ph_most(b->worst_junction[j], fabs(created));
        more(made, created);
    }
    for (size j = 0; j < b->parts; j++) {
        const size at = b->part_junction[j];
        fine &= fabs(r->created[at] - r->divided[at]) <= r->lost[at];
    }
    return fine;
}

/* Sums of the network; whether it closes. */
static int take_network(ph_ledger *b, const ph_row *r, across made) {
    double missed = 0.0;
    for (size k = 0; k < b->c; k++)
        missed += r->allowed[k];
    const double dH = value(r->dH), dissipated = value(r->dissipated), numerical = value(r->numerical);
    const double left = dH + dissipated + numerical - value(r->external) - value(made);
    add(b->dH, 0, dH);
    add(b->dissipation, 0, dissipated);
    add(b->loss, 0, numerical);
    add(b->external, 0, value(r->external));
    add(b->residual, 0, value(made));
    add(b->unexplained, 0, left);
    const double permitted = missed + ULPS * r->pairs;
    add(b->left, 0, permitted * permitted);
    b->worst_unexplained = ph_most(b->worst_unexplained, fabs(left));
    return fabs(left) <= permitted;
}

static int finite(ph_sums s, size n) {
    for (size i = 0; i < n; i++)
        if (!isfinite(s.high[i]) || !isfinite(s.low[i]))
            return 0;
    return 1;
}

/* 1, or 0 where a row is not ordinary: then the sums are not to be used. */
PH_API int ph_ordinary(ph_ledger *b, size ports) {
    for (size i = 0; i < b->n; i++) {
        ph_row r = begun(b);
        across made = {0.0, 0.0};
        take_pairs(b, b->pairs + i * b->q, &r);
        take_components(b, i, &r);
        if (b->parts)
            take_parts(b, b->works + i * b->parts, &r);
        if (!judge_components(b, i, &r) || !take_junctions(b, &r, &made) || !take_network(b, &r, made))
            return 0;
    }
    return finite(b->of_dissipated, b->c) && finite(b->of_supplied, b->c) && finite(b->of_stored, b->c) &&
           (!b->numerical || finite(b->of_numerical, b->c)) && finite(b->gap, b->c) &&
           finite(b->missed, b->c) && finite(b->squares, b->c) && finite(b->of_port, ports) &&
           finite(b->exchanged, b->junctions) && finite(b->of_part, b->parts) && finite(b->unexplained, 1) &&
           finite(b->left, 1) && finite(b->dH, 1) && finite(b->dissipation, 1) && finite(b->external, 1);
}
