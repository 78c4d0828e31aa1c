"""Sensitivities of members by differences: of a step, with rollback, and of the present outputs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.members.member import Member
from phfmu.outcome.limits import defined

Array = NDArray[np.float64]

_NUMBERS = defined(Path(__file__).parent.parent / "couplings" / "runtime" / "in_turn.h")
#: relative change of an input that tells whether outputs follow it;  part of an output below which a change of it is none
MOVE, ROUNDING = _NUMBERS["INSTANT_MOVE"], _NUMBERS["INSTANT_ROUNDING"]


def finite_differences(member: Member, u: Array, t: float, h: float, state: Any, nominal: Array) -> Array:
    """G = dY/dU by one-sided differences with rollback (nu extra steps); the member ends at t + h with inputs u."""

    def outputs(value: Array) -> Array:
        member.set_state(state)
        member.set_input(value)
        member.do_step(t, h)
        return member.output()

    base = outputs(u)
    G = np.zeros((len(u), len(u)))
    for j in range(len(u)):
        step = 1e-6 * (nominal[j] + abs(u[j]))
        moved = u.copy()
        moved[j] += step
        G[:, j] = (outputs(moved) - base) / step
    outputs(u)
    return G


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
