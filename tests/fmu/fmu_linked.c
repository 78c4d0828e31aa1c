/* Two units of different models linked into this program: runs them turn by turn and prints a value of each.
 *
 *     fmu_linked TOKEN STEP REFERENCE TOKEN STEP REFERENCE N
 *
 * Compiled with -DFIRST=name_ -DSECOND=name_, the prefixes of their functions. */
#include <stdio.h>
#include <stdlib.h>

#include "fmi3FunctionTypes.h"

#define JOIN(prefix, name) prefix##name
#define OF(prefix, name) JOIN(prefix, name)

/* The functions of one unit and a run of them: start (k < 0), step k, or print and free (k = n). */
#define UNIT(prefix, run)                                                                                    \
    fmi3InstantiateCoSimulationTYPE OF(prefix, fmi3InstantiateCoSimulation);                                 \
    fmi3EnterInitializationModeTYPE OF(prefix, fmi3EnterInitializationMode);                                 \
    fmi3ExitInitializationModeTYPE OF(prefix, fmi3ExitInitializationMode);                                   \
    fmi3DoStepTYPE OF(prefix, fmi3DoStep);                                                                   \
    fmi3GetFloat64TYPE OF(prefix, fmi3GetFloat64);                                                           \
    fmi3FreeInstanceTYPE OF(prefix, fmi3FreeInstance);                                                       \
    static int run(char **argv, int k, int n) {                                                              \
        static fmi3Instance c;                                                                               \
        const double h = atof(argv[1]);                                                                      \
        const unsigned ref = (unsigned)atoi(argv[2]);                                                        \
        bool event, end, early;                                                                              \
        double value, last;                                                                                  \
        if (k < 0) {                                                                                         \
            c = OF(prefix, fmi3InstantiateCoSimulation)("linked", argv[0], NULL, 0, 0, 0, 0, NULL, 0, NULL,  \
                                                        NULL, NULL);                                         \
            return !c || OF(prefix, fmi3EnterInitializationMode)(c, 0, 0.0, 0.0, 0, 0.0) ||                  \
                   OF(prefix, fmi3ExitInitializationMode)(c);                                                \
        }                                                                                                    \
        if (k < n)                                                                                           \
            return OF(prefix, fmi3DoStep)(c, k * h, h, 1, &event, &end, &early, &last);                      \
        if (OF(prefix, fmi3GetFloat64)(c, &ref, 1, &value, 1))                                               \
            return 1;                                                                                        \
        printf("%.17g\n", value);                                                                            \
        OF(prefix, fmi3FreeInstance)(c);                                                                     \
        return 0;                                                                                            \
    }

UNIT(FIRST, first)
UNIT(SECOND, second)

int main(int argc, char **argv) {
    int failed = argc != 8, n = failed ? 0 : atoi(argv[7]);
    for (int k = -1; k <= n && !failed; k++)
        failed = first(argv + 1, k, n) || second(argv + 4, k, n);
    return failed;
}
