"""When the iteration of a step is accepted: both masters decide alike, and the rules are what they say."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import pytest

from phfmu.network.couplings import acceptance
from phfmu.network.couplings.acceptance import BY_ENERGY, BY_FLOOR, ENERGY, FLOOR, ROUNDING, STALLED, Progress
from phfmu.network.couplings.compiled.master import ACCEPTED
from phfmu.network.couplings.compiled.master_library import HEADER, library


class Compiled:
    """The rules of the compiled master, for sequences of residuals."""

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


class InPython:
    def __init__(self, held: bool):
        self._progress = Progress(held)

    def decides(self, scaled: float, floor: bool, left: float) -> tuple[str, bool]:
        self._progress.note(scaled)
        by = self._progress.accepted(lambda: floor, left, 1.0)
        takes = self._progress.takes_matrix(left, 1.0)
        self._progress.matrices += takes
        return by, takes


@pytest.mark.parametrize("held", [True, False])
def test_both_masters_decide_alike(held: bool) -> None:
    """Sequences that shrink, stall and grow, through every test of the rules, also at the very limits."""
    rng = np.random.default_rng(7)
    seen = set()
    for _ in range(700):
        one, two = Compiled(held), InPython(held)
        scaled, left = 10.0 ** rng.uniform(-12, 0), 10.0 ** rng.uniform(-15, -8)
        for _ in range(9):
            scaled *= rng.choice([1e-4, 0.1, 0.3, 0.4, 0.5, 0.6, 1.0, 1.5])
            left *= rng.choice([1e-3, 0.3, 1.0])
            now = (
                rng.choice([scaled, ROUNDING]),
                bool(rng.random() < 0.05),
                rng.choice([left, ENERGY, STALLED * ENERGY]),
            )
            found = one.decides(*now)
            assert found == two.decides(*now)
            seen.add(found)
    assert {by for by, _ in seen} == {"", BY_ENERGY, BY_FLOOR} and {takes for _, takes in seen} == {held, True}


@pytest.mark.parametrize("kind", [Compiled, InPython])
def test_the_rules(kind: Any) -> None:
    """What is solved; rows at rounding; rows that stay within the energy."""
    assert kind(False).decides(ROUNDING, False, ENERGY)[0] == BY_ENERGY
    assert kind(False).decides(ROUNDING, False, 1.01 * ENERGY)[0] == ""
    assert kind(False).decides(1.01 * ROUNDING, False, ENERGY)[0] == ""
    for held in (True, False):
        stays = kind(held)
        assert [stays.decides(1e-6, i == 3, 1.0)[0] for i in range(4)] == ["", "", "", BY_FLOOR]
        stays = kind(held)
        found = [stays.decides(1e-6, False, 0.0)[0] for _ in range(6)]
        assert found == ["", "", "", "", BY_FLOOR, BY_FLOOR]
    assert FLOOR == 16
