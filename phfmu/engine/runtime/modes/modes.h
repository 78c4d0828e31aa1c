/* Modes of ideal switches: which one follows at an event, how it is entered, and steps that go from one to
 * the next without leaving compiled code.
 *
 * A mode is a model of its own with the states, parameters and inputs of all others; its equations at an
 * instant are those of events/switch_system.py. The mode that follows obeys 0 <= c, 0 <= mu, mu c = 0 for all
 * unilateral switches soon after it: over a very short backward Euler step, in which rates of c count where c
 * is zero, and impulses where it cannot stay; its complementarity problem is that of the limit (Camlibel,
 * Heemels, van der Schaft, Schumacher, IEEE TCAS-I 50, 2003). Modes are tried by how many switches they
 * change. Where multipliers are mu + D t, D the directions that no row determines, mu is least in norm; a
 * switch whose share falls to zero opens only if no t keeps all mu + D t >= 0 with that one above zero.
 *
 * On entering, states jump along L = E^-1 df/da N only, N the null space of dg/da:
 *     c = N^T g = 0 after it,  S = L^T H'' L,  x+ = x- + L m,  m = -S^-1 c-,  lost = -1/2 m^T (c- + c+). */
#ifndef PH_MODES_H
#define PH_MODES_H

#include "events.h"

/* Mirror of SwitchTables; all tables are constant. x = [states | time], Y = [algebraic variables | inputs].
 */
typedef struct ph_switches {
    int n;      /* switches */
    int nevent; /* state events, the same in all modes */
    int nx, na, nu, np, ncomp;
    int a_end;   /* place of the algebraic variables now in a signal table */
    int told;    /* length of a signal table up to the observables that all modes have */
    int nresult; /* results of rates */
    const ph_code *code;
    const ph_group *rates;         /* columns of f fx fa g gx ga c cx ca gap and E, see mode_rates.c */
    const ph_group *energy;        /* d H / d x, ncomp x nx, by columns */
    const int *place;              /* n: parameter that is its mode */
    const int *multiplier;         /* n: algebraic variable */
    const int *owner;              /* n: component that its loss is booked at */
    const signed char *unilateral; /* n: else free */
    const signed char *gaps;       /* n: 1 = closes where a gap does */
    const double *nominal;         /* n: of c */
    const double *most;            /* n: largest multiplier that may be cut where states jump */
    const double *size;            /* nx: nominal states */
    const double *scale;           /* na: nominal algebraic variables */
    const int *when_ptr;           /* n+1: closes while the parameters have these values */
    const int *when_p;
    const double *when_value;
} ph_switches;

/* The rows of a mode that are known before there is a model of it: directions of the algebraic variables that
 * no row determines, each with the row that a row of its own stands in. */
typedef struct ph_mode_rows {
    int nfree;
    const signed char *on;  /* n: 1 or 0 for each switch */
    const int *free_at;     /* nfree */
    const double *free_row; /* nfree*na */
} ph_mode_rows;

/* A mode with its instance, which others may use in between. Its landing stops before all events. */
typedef struct ph_mode {
    const ph_mode_rows *rows;
    ph_instance *in;
    ph_landing *landing;
    const void *fresh; /* the state of an instance that is new */
    int length;        /* of its signal table */
} ph_mode;

/* The source of modes; `world` is the caller's. rows: NULL if there is no such mode; mode: the same with
 * its instance, of which none may be left. most: how much switch j could
 * hold, of those that open from the mode `on` with the algebraic variables a (na). */
typedef struct ph_mode_source {
    void *world;
    const ph_mode_rows *(*rows)(void *world, const signed char *on);
    const ph_mode *(*mode)(void *world, const signed char *on);
    double (*most)(void *world, const signed char *on, const double *a, int j);
} ph_mode_source;

typedef struct ph_modes ph_modes;

/* Why a change of modes is refused, after those of ph_event_reason. */
enum { PH_REFUSED_NO_MODE = PH_REFUSED_SLIDES + 1, PH_REFUSED_SHARED };

typedef struct ph_mode_refusal {
    int reason; /* -1: none, ask the landing of ph_modes_failed */
    double t, value, limit;
    const signed char *which; /* n: switches */
} ph_mode_refusal;

/* Bytes for the changes of modes; memory: so many, aligned for double, owned by the caller, as are switches,
 * source and sides, which outlive it. sides (1+2n), all there is to save: 1 once modes fit the state, the
 * mode it is in, the one that was asked for. */
PH_API size_t ph_modes_size(const ph_switches *switches);
PH_API ph_modes *ph_modes_init(void *memory, const ph_switches *switches, const ph_mode_source *source,
                               signed char *sides);
/* Steps will be about as long as h. */
PH_API void ph_modes_prepare(ph_modes *m, double h);
/* ph_land_from and ph_land of the present mode and those that follow. changed: events*n, 1 = the switch
 * went off, 2 = on. Rows of signals: what all modes have, then the energies. */
PH_API void ph_modes_from(ph_modes *m, double t0, double h, int first, int n, int changed);
PH_API void ph_modes_to(ph_modes *m, double t, double end, int changed); /* as ph_land_to */
PH_API int ph_modes_land(ph_modes *m, const ph_record *record, ph_landed *out, signed char *changed);
/* ph_land_begin and ph_land_on of modes, but after a status other than PH_OK sides and instance are to be
 * restored.
 */
PH_API void ph_modes_begin(ph_modes *m, double t, double h, int n);
PH_API int ph_modes_on(ph_modes *m, ph_landed *out, signed char *changed);
/* The largest value that switch j could hold, of those that open from a mode with the algebraic variables a
 * (na): for `most` of a source. Infinite where directions share multipliers, so that this is not told. */
PH_API double ph_mode_held(const ph_switches *switches, const ph_mode_rows *mode, const double *a, int j);
/* The present mode; NULL after its source had none. */
PH_API const ph_mode *ph_modes_present(ph_modes *m);
PH_API const ph_mode_refusal *ph_modes_refusal(const ph_modes *m);
/* The mode whose instance answered the last status: the present one, or the next that cannot be entered. */
PH_API const ph_mode *ph_modes_failed(const ph_modes *m);

#endif
