/* Refused state events of members that land as one composed declaration: what fmu_landing asks for. */
#ifndef PH_COMPOSED_REFUSAL_H
#define PH_COMPOSED_REFUSAL_H

#include "fmu.h"

int fmu_composed_refused(const fmu *f, const char *function);

#endif
