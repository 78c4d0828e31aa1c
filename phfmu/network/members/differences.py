"""Sensitivities of the present outputs of members, by differences; those of a step are in `couplings/runtime/share.c`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phfmu.network.members.member import Member
from phfmu.outcome.limits import defined

Array = NDArray[np.float64]

_NUMBERS = defined(Path(__file__).parent.parent / "couplings" / "runtime" / "in_turn.h")
#: relative change of an input that tells whether outputs follow it;  part of an output below which a change of it is none
MOVE, ROUNDING = _NUMBERS["INSTANT_MOVE"], _NUMBERS["INSTANT_ROUNDING"]


def instant_sensitivity(member: Member, u: Array) -> Array:
    """G = dy/dU (nu x nu) of a member at the present time; its inputs are u again afterwards."""
    member.set_input(u)  # what it tells may still be of others
    base = np.array(member.end_output())
    G = np.zeros((len(u), len(u)))
    for j in range(len(u)):
        moved = u.copy()
        moved[j] += MOVE * (abs(u[j]) + member.nominal[j])
        member.set_input(moved)
        change = np.array(member.end_output()) - base
        change[np.abs(change) <= ROUNDING * np.abs(base)] = 0.0
        G[:, j] = change / (moved[j] - u[j])
    member.set_input(u)
    return G
