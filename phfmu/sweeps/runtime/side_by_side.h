/* Runs of one model whose steps are taken together as long as nothing unusual happens to them: the bits of
 * each are those of steps of its own. */
#ifndef PH_LANES_OF_RUNS_H
#define PH_LANES_OF_RUNS_H

#include "books.h"
#include "wide.h"

typedef struct ph_lanes {
    ph_wide *wide;
    ph_instance *in[PH_LANE_WIDTH]; /* where the numbers of a run are while it is not inside */
    unsigned inside;                /* bit l: run l is stepped with the others */
    int sweeps;                     /* 1: steps are those of a Schur stepper */
    unsigned clock;                 /* steps of the stretch */
    unsigned period[PH_LANE_WIDTH]; /* a run that has left enters at multiples of so many steps */
    long long taken;                /* steps of runs inside since the start */
    const ph_books *books;          /* of all runs, compiled for these */
    double *row[PH_NROW];           /* ledger of the last step of each */
} ph_lanes;

PH_API size_t ph_lanes_size(const ph_model *model, const ph_code *code);
/* PH_ARGUMENT: steps of the model are not those of wide.h; the solver of `code` is for so many runs. */
PH_API int ph_lanes_init(void *memory, const ph_model *model, const ph_code *code, const ph_books *books);
/* Steps that runs have taken inside. */
PH_API long long ph_lanes_taken(const ph_lanes *lanes);

/* All runs have their numbers in their instances again. */
void ph_lanes_leave(ph_lanes *lanes);
/* After a step of the instance of run l: its ledger is with the others, and the run goes on inside if it can.
 */
void ph_lanes_enter(ph_lanes *lanes, int l, ph_instance *in);
/* One step of the runs inside; those that took it. The others of them have left. */
unsigned ph_lanes_step(ph_lanes *lanes, double t, double h);
/* Signals first..first+n-1 of a run inside, into its instance. */
void ph_lanes_show(const ph_lanes *lanes, int l, int first, int n);
/* Stored energy [ncomp] of run l. */
void ph_lanes_show_energy(const ph_lanes *lanes, int l, double *energy);

#endif
