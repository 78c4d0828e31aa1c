/* A call of a function of a unit: its name stands in the unit while it is under way, so that a crash in it is
 * found, and what it answers counts as in the loop in Python: a warning is ok, all beyond is not. */
#include "unit.h"

enum { WARNING = 1, FATAL = 4 };

int ph_unit_dead(const ph_unit *u) {
    return u->answer == FATAL;
}

int ph_unit_begin(ph_unit *u, const char *call) {
    if (ph_unit_dead(u))
        return 0;
    u->call = call;
    return 1;
}

int ph_unit_answer(ph_unit *u, int status) {
    if (status > WARNING) {
        u->answer = status;
        u->refused = u->call;
    }
    u->call = NULL;
    return status > WARNING ? PH_REFUSED : PH_OK;
}
