/* Ideal switches of a unit: what is generated of them, and the functions of fmu_modes.c. */
#ifndef FMU_MODES_H
#define FMU_MODES_H

#include "fmu.h"

/* A mode of ideal switches: its model, and its names of the rows. */
typedef struct fmu_mode {
    const ph_model *model;
    const struct ph_events *events;
    fmu_equations rows;
} fmu_mode;

/* Functions of fmu_modes.c, which only units with ideal switches have. */
struct ph_switches;
struct ph_mode_rows;
typedef struct fmu_switches {
    const struct ph_switches *switches;
    int n;                           /* modes */
    const struct ph_mode_rows *rows; /* n */
    const fmu_mode *modes;           /* n; the first one is that of the start */
    const char *const *names;        /* of the switches */
    size_t (*state_size)(const fmu *f);
    void (*save)(const fmu *f, void *out);
    int (*load)(fmu *f, const void *from);
    const char *(*fault)(const fmu *f, const void *from); /* as ph_state_fault */
    void (*reset)(fmu *f);
    void (*asked)(const fmu *f, double *p);
    void (*ask)(fmu *f, double *p);
} fmu_switches;

/* fmu_modes.c, as fmu_landing and fmu_switches. State of the model: modes, then the state of the present
 * instance, with room for the largest. `asked` puts the modes that were asked for last into the parameters p;
 * `ask` asks for those in p, and puts the present ones there. */
int fmu_modes_create(fmu *f);
void fmu_modes_release(fmu *f);
int fmu_modes_step(fmu *f, double t, double h, int n, int *stopped);
int fmu_modes_refused(const fmu *f, const char *function);
size_t fmu_modes_state_size(const fmu *f);
void fmu_modes_save(const fmu *f, void *out);
int fmu_modes_load(fmu *f, const void *from);
const char *fmu_modes_fault(const fmu *f, const void *from);
void fmu_modes_reset(fmu *f);
void fmu_modes_asked(const fmu *f, double *p);
void fmu_modes_ask(fmu *f, double *p);

/* fmu_mode_refused.c: why a change of modes was refused, and which of n switches are to blame. */
struct ph_mode_refusal;
int fmu_mode_refused(const fmu *f, const char *function, const struct ph_mode_refusal *r, int n,
                     const char *const *switches);

#endif
