/* State events of the unit of a network: what fmu_landing asks for. */
#ifndef PH_NETWORK_LANDING_H
#define PH_NETWORK_LANDING_H

#include "fmu.h"

/* Memory is the network's own. */
int fmu_network_create(fmu *f);
void fmu_network_release(fmu *f);
/* The steps of the network, in which its events happen; it does not stop at them. */
int fmu_network_step(fmu *f, double t, double h, int n, int *stopped);
int fmu_network_refused(const fmu *f, const char *function);

#endif
