/* Step maps: the interface of what takes steps, a model or the coupled members of a network.
 *
 * A step map takes (state, inputs at the nodes of a step) to (state, outputs at the nodes, ledger); it can be
 * saved, and restored to the bit. Its values stand in tables of the blocks of phfmu.h. Who drives one, a unit
 * or a run, calls it through these functions, each with what the map is `of`; they answer a ph_status, and
 * after a refused step the map is exactly where it was. */
#ifndef PH_STEP_MAP_H
#define PH_STEP_MAP_H

#include "phfmu.h"

/* The sizes of the blocks. */
typedef struct ph_sizes {
    int nx;
    int na;
    int nu;
    int nq;
    int np;
    int nobs;
    int ncomp;
    int k;                 /* values of each input: the nodes of a step */
    const double *weights; /* k */
} ph_sizes;

/* The folder of the files of a unit, and the function that is told why a call was refused. */
typedef struct ph_surroundings {
    const char *resources; /* its folder, a path or an URI; NULL: nobody has told */
    const char *name;      /* of the instance */
    void (*say)(void *with, const char *text);
    void *with;
} ph_surroundings;

/* The functions of phfmu.h of these names; `about`: the constant part of the map, a ph_model or a
 * ph_network, or a unit of another tool. A saved state is zero before the first `save` into it. */
typedef struct ph_step_map {
    void (*sizes)(const void *about, ph_sizes *sizes);
    size_t (*size)(const void *about);
    int (*init)(void *memory, const void *about);
    int (*open)(void *of, const ph_surroundings *around); /* before anything else; NULL: it needs no files */
    void (*release)(void *of);                            /* what init has allocated besides; NULL: nothing */
    int (*reset)(void *of);
    int (*initialise)(void *of);
    int (*refresh)(void *of);
    int (*set_x)(void *of, double t, const double *x);
    int (*set_parameters)(void *of, const double *p);
    int (*set_input)(void *of, const double *u);
    int (*set_node_inputs)(void *of, const double *u);
    int (*step_parts)(void *of, double t, double h, int n);
    int (*skip)(void *of, double t);
    const double *(*signals)(const void *of);
    const double *(*ledger)(const void *of, int row);
    const double *(*parameters)(const void *of);
    const double *(*input)(const void *of);
    const double *(*node_outputs)(const void *of);
    const long long *(*counts)(const void *of);
    const ph_report *(*report)(const void *of);
    int (*part)(const void *of); /* the part whose equations the report is about: a member's number */
    int (*sensitivity)(void *of, double *s);
    int (*sensitivity_end)(void *of, double *s);
    int (*kept_size)(const void *about);
    void (*keep)(const void *of, double *kept);
    void (*join)(void *of, const double *kept, double part);
    size_t (*state_size)(const void *of);
    int (*save)(void *of, void *out);
    int (*load)(void *of, const void *from);
    const char *(*state_fault)(const void *of, const void *from);
    int (*returns)(
        const void *about); /* whether states are saved, and refused steps taken back; NULL: they are */
    /* What a saved state holds besides its bytes; NULL: nothing. It is freed; how many bytes it becomes;
     * these, after which `state` holds none; it is made of n bytes. `state`: a copy in the last two. */
    void (*forget)(void *of, void *state);
    int (*held_size)(void *of, void *state, size_t *n);
    int (*write_held)(void *of, void *state, char *bytes);
    int (*read_held)(void *of, void *state, const char *bytes, size_t n);
    const double *(*joined)(const void *of); /* what only the whole tells: values at its junctions, or NULL */
} ph_step_map;

void ph_sizes_of(const ph_model *model, ph_sizes *sizes);

/* The map of a model, `of` its instance. */
PH_API const ph_step_map *ph_map_model(void);

/* offset: PH_NBLOCK+1 places of the blocks in the table of signals, the last one its length. */
static inline void ph_places(const ph_sizes *s, int *offset) {
    const int length[PH_NBLOCK] = {s->nx,    1,        s->na, s->nq, s->nq,   s->ncomp,
                                   s->ncomp, s->ncomp, s->na, s->nq, s->nobs, s->ncomp};
    offset[0] = 0;
    for (int i = 0; i < PH_NBLOCK; i++)
        offset[i + 1] = offset[i] + length[i];
}

#endif
