/* Threads that take parts of the master's work: those who call ph_crew_help, from wherever they were started.
 * Which of them takes a part changes nothing of it, so results do not depend on their number. */
#ifndef PH_CREW_H
#define PH_CREW_H

#include "phfmu.h"

/* `each`: part(with, i) for i = 0..n-1, by the caller and those who help. */
typedef struct ph_crew {
    void (*each)(struct ph_crew *c, int n, void (*part)(void *, int), void *with);
} ph_crew;

/* Bytes of memory, aligned for double and owned by the caller, who also ends all help before it goes. */
PH_API size_t ph_crew_size(void);
PH_API ph_crew *ph_crew_init(void *memory);
/* Helps until ph_crew_end is called; what is called after that returns at once. */
PH_API void ph_crew_help(ph_crew *c);
PH_API void ph_crew_end(ph_crew *c);

/* The same; of no crew, or where there is nothing to share, by the caller alone, in order. */
static inline void ph_crew_each(ph_crew *c, int n, void (*part)(void *, int), void *with) {
    if (c && n > 1)
        c->each(c, n, part, with);
    else
        for (int i = 0; i < n; i++)
            part(with, i);
}

#endif
