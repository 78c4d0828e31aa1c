"""Random polynomials, points and steps between them."""

from __future__ import annotations

import itertools
import math

import casadi as ca
import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

EPS = np.finfo(float).eps
N = 3
X = ca.SX.sym("x", N)
EXPONENTS = [e for e in itertools.product(range(5), repeat=N) if 1 <= sum(e) <= 4]
P = ca.SX.sym("p", len(EXPONENTS))
POLYNOMIAL = sum(P[i] * math.prod(X[j] ** e[j] for j in range(N)) for i, e in enumerate(EXPONENTS))
unit = st.floats(-1.0, 1.0, allow_subnormal=False)
points = arrays(float, N, elements=unit)
coefficients = arrays(float, len(EXPONENTS), elements=unit)
#: x' - x of every size: 0.1 .. 1e-16, and zero
increments = st.tuples(points, st.sampled_from([0.0, *(10.0**-n for n in range(1, 17))])).map(lambda v: v[0] * v[1])
