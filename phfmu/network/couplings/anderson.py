"""Anderson coupling: interface fixed point with least-squares acceleration (IQN-ILS), for members without sensitivities.

With the junction rows r(xi) of held inputs, f(xi) = -M^-1 r(xi) is the residual of the fixed point xi + f. From differences X of
earlier xi and F of f, of this step and of the steps before,

    xi <- xi + f - (X + F) c,     c = argmin |S (f - F c)|.

M = C where junctions join an output to each input, which makes the fixed point that of Jacobi's iteration; where they do not
(rigid links, bare nodes), M is the matrix of a Newton step, taken once. S scales each unknown by its size.  The iteration is
`runtime/anderson.c`.

Source: Degroote, Bathe, Vierendeels, Comput. Struct. 87 (2009) 793; columns whose new share is rounding are dropped.
"""

from __future__ import annotations

from phfmu.network.couplings.acceptance import RULES
from phfmu.outcome.limits import defined

_NUMBERS = defined(RULES.parent / "anderson.h")

#: differences kept, and trials of a step
WINDOW, ITERATIONS = int(_NUMBERS["ANDERSON_WINDOW"]), int(_NUMBERS["ANDERSON_ITERATIONS"])


class Anderson:
    """One value per junction unknown and step, held, as with `Newton`; members need no sensitivities."""

    order, repeats, closes = 2, True, True
