/* When the iteration of a step of coupled members is accepted. The words are those of the engines' Newton, of
 * which this is the outer one. */
#ifndef PH_ACCEPTANCE_H
#define PH_ACCEPTANCE_H

#include "phfmu.h"

#define PH_COUPLED_ITERATIONS 30

/* Energy that the rows leave, relative to the energy in play. */
#define PH_COUPLED_ENERGY 1e-14

/* Scaled residual that counts as solved; where values are held, one below the second that stays is rounding,
 * if the energy is. */
#define PH_COUPLED_ROUNDING 1e-13
#define PH_COUPLED_STAGNATION 1e-9

/* Where sums at ends of an accepted step are more than this part of their terms, one more impulse makes them
 * zero. */
#define PH_COUPLED_END 1e-15

/* A scaled residual that shrinks to more than this part of the last hardly shrinks: it stalls. Where values
 * are held, to more than the second: halving is what rounding in members can do. */
#define PH_COUPLED_SHRINKING 0.5
#define PH_COUPLED_STALLING 0.3

/* Where held values stall, as many times the energy is accepted. */
#define PH_COUPLED_STALLED 100

/* So many stalls within the energy, with a matrix taken after the first, and what is left is rounding. */
#define PH_COUPLED_STALLS 3

/* The same where members do not take a step again to rounding, whose rows are this part of their terms. */
#define PH_COUPLED_NEARLY 1e-2

/* Units of rounding in a row or in a move of an unknown that cannot be told from zero. */
#define PH_COUPLED_FLOOR 16

/* So many steps tell what the continuation of the last one will miss. */
#define PH_COUPLED_KNOWN 4

/* held: every member holds one value, else they exchange values at the nodes of the step. */
typedef struct ph_rules {
    int held;
    int iterations;
    int sweeps;      /* so many trials are the step, whatever they leave; 0: these rules decide */
    int accept;      /* of a step that does not converge the trial that left the least is kept */
    double repeated; /* scaled residual that members make which take a step again to so much only, 0: to
                        rounding */
} ph_rules;

/* How an iteration went so far; all zero before the first trial. */
typedef struct ph_progress {
    int trials;
    int stalled;
    int stalls;
    int matrices;  /* that were taken */
    int resting;   /* the unknowns of the last trial are those of the one before, but for rounding */
    double scaled; /* residual of the last trial */
} ph_progress;

typedef enum ph_accepted { PH_NOT_YET, PH_BY_ENERGY, PH_BY_FLOOR, PH_UNCONVERGED } ph_accepted;

/* How much energy rows leave: more than what is accepted, as much where they stall, or no more. */
typedef enum ph_energy_left { PH_TOO_MUCH, PH_WHERE_STALLED, PH_WITHIN } ph_energy_left;

/* One more trial with its largest scaled residual. */
PH_API void ph_coupled_note(const ph_rules *r, ph_progress *p, double scaled);
/* Whether what is below depends on the energy that rows leave; else PH_TOO_MUCH does for it. */
PH_API int ph_coupled_asks_energy(const ph_rules *r, const ph_progress *p);
/* floor: whether all rows are rounding, asked for only if they stalled and there is a matrix. */
PH_API int ph_coupled_accepted(const ph_rules *r, const ph_progress *p, int floor, int left);
/* Whether what was not accepted needs a matrix of its last trial. */
PH_API int ph_coupled_takes_matrix(const ph_rules *r, const ph_progress *p, int left);

#endif
