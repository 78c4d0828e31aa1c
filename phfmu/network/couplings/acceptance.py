"""Words and numbers of accepted steps; the rules are `runtime/acceptance.c`, which has the numbers too (`acceptance.h`).

    energy:          energy left within budget, and every row at rounding
    rounding floor:  rows that stopped shrinking within it, or rows that a relative change of the unknowns by eps explains
    unconverged:     the trial that left the least, kept where that was asked for

Rows of stiff members that hardly act stop at what such a change makes of them.
"""

from __future__ import annotations

from pathlib import Path

from phfmu.outcome.limits import defined

RULES = Path(__file__).parent / "runtime" / "acceptance.h"
_NUMBERS = defined(RULES)

ITERATIONS = int(_NUMBERS["COUPLED_ITERATIONS"])
#: steps that tell what the continuation of the last one will miss
KNOWN = int(_NUMBERS["COUPLED_KNOWN"])

BY_ENERGY, BY_FLOOR = "energy", "rounding floor"
#: of steps that did not converge and were kept, or taken in parts
KEPT, HALVED = "unconverged", "halved"
#: in the order of `ph_accepted`
ACCEPTED = ("", BY_ENERGY, BY_FLOOR, KEPT)
