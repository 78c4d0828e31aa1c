"""When the iteration of a step is accepted."""

from __future__ import annotations

import ctypes
from typing import Any

import pytest

from phfmu.network.couplings import acceptance
from phfmu.network.couplings.acceptance import ACCEPTED, BY_ENERGY, BY_FLOOR, RULES
from phfmu.network.couplings.compiled.master_library import HEADER, library
from phfmu.outcome.limits import defined

ENERGY, ROUNDING, STALLED, FLOOR = (defined(RULES)[f"COUPLED_{n}"] for n in ("ENERGY", "ROUNDING", "STALLED", "FLOOR"))


class Rules:
    """The rules of acceptance, for sequences of residuals."""

    def __init__(self, held: bool):
        self._rules, self._progress = (HEADER.structures[n]() for n in ("ph_rules", "ph_progress"))
        self._rules.held, self._rules.iterations = held, acceptance.ITERATIONS
        self._at = [ctypes.byref(s) for s in (self._rules, self._progress)]

    def decides(self, scaled: float, floor: bool, left: float) -> tuple[str, bool]:
        lib: Any = library()
        lib.ph_coupled_note(*self._at, ctypes.c_double(scaled))
        how_much = 2 if left <= ENERGY else 1 if left <= STALLED * ENERGY else 0
        if not lib.ph_coupled_asks_energy(*self._at):  # as its loop does: energies take an evaluation of all members
            how_much = 0
        by = lib.ph_coupled_accepted(*self._at, int(floor), how_much)
        takes = bool(lib.ph_coupled_takes_matrix(*self._at, how_much))
        self._progress.matrices += takes
        return str(ACCEPTED[by]), takes


def test_the_rules() -> None:
    """What is solved; rows at rounding; rows that stay within the energy."""
    assert Rules(False).decides(ROUNDING, False, ENERGY)[0] == BY_ENERGY
    assert Rules(False).decides(ROUNDING, False, 1.01 * ENERGY)[0] == ""
    assert Rules(False).decides(1.01 * ROUNDING, False, ENERGY)[0] == ""
    for held in (True, False):
        stays = Rules(held)
        assert [stays.decides(1e-6, i == 3, 1.0)[0] for i in range(4)] == ["", "", "", BY_FLOOR]
        stays = Rules(held)
        found = [stays.decides(1e-6, False, 0.0)[0] for _ in range(6)]
        assert found == ["", "", "", "", BY_FLOOR, BY_FLOOR]
    assert FLOOR == 16


@pytest.mark.parametrize("held", [True, False])
def test_a_matrix_is_taken_where_rows_stall(held: bool) -> None:
    """Of held values at each trial; of values at nodes at the first, at the first stall, and while too much energy is left."""
    rules = Rules(held)
    taken = [rules.decides(scaled, False, 1.0)[1] for scaled in (1.0, 1e-2, 1e-3, 0.9e-3, 0.8e-3, 1e-5)]
    assert taken == ([True] * 6 if held else [True, False, False, True, True, False])
