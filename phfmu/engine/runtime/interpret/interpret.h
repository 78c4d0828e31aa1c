/* Functions as tables of operations, which the runtime runs without a compiler.
 *
 * A program works on slots [constants | arguments | results of its operations]. Operations stand in segments:
 * equal ones that do not depend on each other, so that a segment is a loop. The Python side reads the
 * structures and the names of the operations from this header; a name is that of CasADi's operation
 * OP_<NAME>, and an expression is what CasADi writes into C text for it, so that results are the same bits.
 */
#ifndef PH_INTERPRET_H
#define PH_INTERPRET_H

#include "phfmu.h"

#define PH_UNARY(X)                                                                                          \
    X(neg, -a)                                                                                               \
    X(exp, exp(a))                                                                                           \
    X(log, log(a))                                                                                           \
    X(sqrt, sqrt(a))                                                                                         \
    X(sq, a *a)                                                                                              \
    X(twice, 2. * a)                                                                                         \
    X(sin, sin(a))                                                                                           \
    X(cos, cos(a))                                                                                           \
    X(tan, tan(a))                                                                                           \
    X(asin, asin(a))                                                                                         \
    X(acos, acos(a))                                                                                         \
    X(atan, atan(a))                                                                                         \
    X(not, !a)                                                                                               \
    X(floor, floor(a))                                                                                       \
    X(ceil, ceil(a))                                                                                         \
    X(fabs, fabs(a))                                                                                         \
    X(sign, a < 0 ? -1 : a > 0 ? 1 : a)                                                                      \
    X(erf, erf(a))                                                                                           \
    X(inv, 1. / a)                                                                                           \
    X(sinh, sinh(a))                                                                                         \
    X(cosh, cosh(a))                                                                                         \
    X(tanh, tanh(a))                                                                                         \
    X(asinh, asinh(a))                                                                                       \
    X(acosh, acosh(a))                                                                                       \
    X(atanh, atanh(a))                                                                                       \
    X(log1p, log1p(a))                                                                                       \
    X(expm1, expm1(a))

#define PH_BINARY(X)                                                                                         \
    X(add, a + b)                                                                                            \
    X(sub, a - b)                                                                                            \
    X(mul, a *b)                                                                                             \
    X(div, a / b)                                                                                            \
    X(pow, pow(a, b))                                                                                        \
    X(constpow, pow(a, b))                                                                                   \
    X(lt, a < b)                                                                                             \
    X(le, a <= b)                                                                                            \
    X(eq, a == b)                                                                                            \
    X(ne, a != b)                                                                                            \
    X(and, a &&b)                                                                                            \
    X(or, a || b)                                                                                            \
    X(fmod, fmod(a, b))                                                                                      \
    X(copysign, copysign(a, b))                                                                              \
    X(if_else_zero, a ? b : 0)                                                                               \
    X(fmin, a < b || b != b ? a : b)                                                                         \
    X(fmax, a > b || b != b ? a : b)                                                                         \
    X(atan2, atan2(a, b))                                                                                    \
    X(hypot, hypot(a, b))                                                                                    \
    X(remainder, remainder(a, b))

typedef struct ph_program {
    int nargument, nresult; /* arrays that it is called with, and that it writes */
    int nconstant, nsegment;
    int nslot;
    const int *argument;    /* nargument: their lengths */
    const int *result;      /* nresult */
    const double *constant; /* nconstant */
    const int *segment;     /* 2 nsegment: operation, how many of it */
    const int *operand;     /* slots: one of each unary operation, two of each binary one */
    const int *out;         /* slots of the results, one array after the other */
} ph_program;

/* `program` of an interpreted kernel; ledger: NULL if it has none. That of a function is a ph_program. */
typedef struct ph_programs {
    const ph_program *value;
    const ph_program *full;
    const ph_program *ledger;
} ph_programs;

PH_API void ph_interpret_value(const ph_kernel *self, const ph_group *g, const ph_point *at, ph_real *target);
PH_API void ph_interpret_full(const ph_kernel *self, const ph_group *g, const ph_point *at, ph_real *target,
                              ph_real *slots);
PH_API void ph_interpret_ledger(const ph_kernel *self, const ph_group *g, const ph_point *at, ph_real *stored,
                                ph_real *moved, ph_real *lost, ph_real *numerical);

PH_API int ph_interpret_function(const ph_function *self, const double **arg, double **res, int *iw,
                                 double *w, int mem);

#endif
