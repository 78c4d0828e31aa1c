/* Threads that take parts of the master's work: those who call ph_crew_help, from wherever they were started.
 * Which of them takes a part changes nothing of it, so results do not depend on their number. */
#ifndef PH_CREW_H
#define PH_CREW_H

#include "phfmu.h"

typedef struct ph_crew ph_crew;

/* Bytes of memory, aligned for double and owned by the caller, who also ends all help before it goes. */
PH_API size_t ph_crew_size(void);
PH_API ph_crew *ph_crew_init(void *memory);
/* Helps until ph_crew_end is called; what is called after that returns at once. */
PH_API void ph_crew_help(ph_crew *c);
PH_API void ph_crew_end(ph_crew *c);

/* part(with, i) for i = 0..n-1, by the caller and those who help; NULL: by the caller alone, in order. */
void ph_crew_each(ph_crew *c, int n, void (*part)(void *, int), void *with);

#endif
