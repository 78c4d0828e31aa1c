"""The shape of couplings: one that finds junction unknowns is all that a new one brings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from phfmu import (
    Collocated,
    Coupled,
    EngineMember,
    Monolithic,
    Network,
    Options,
    PythonInstance,
    Status,
    StepFailure,
    build_model,
    run,
)
from phfmu.components.mechanical.translational import mass, spring
from phfmu.network.couplings.coupling import Solution, Step
from phfmu.network.couplings.newton import Newton
from phfmu.network.interface.joined import Joined

H = 0.01


def pair() -> Network:
    """A mass on a spring whose far end is free, joined by a plain bond."""
    net = Network("pair")
    net.add("m", mass(1.0, q=0.1))
    net.add("s", spring(40.0, elongation=0.1))
    net.connect("m.flange", "s.a", name="joint")
    return net


def members(net: Network) -> list[Any]:
    models = {name: build_model(part) for name, part in net.members.items()}
    return [EngineMember(name, model, PythonInstance(model)) for name, model in models.items()]


class Repeated:
    """Jacobi's iteration: members repeat the step with each other's outputs until these stay."""

    order, repeats, closes = 2, True, True

    def __init__(self, trials: int = 60):
        self.trials = trials

    def solve(self, joined: Joined, last: Solution, step: Step) -> Solution:
        C, P = joined.face.C.toarray(), joined.face.P
        xi: Any = last.xi
        for i in range(self.trials):
            if i > 0:
                joined.restore(step.states)
            y = joined.trial(xi, step.t, step.h)
            new: Any = np.linalg.solve(C, -P.T @ y)
            if (abs(new - xi) <= 1e-14 * (1e-3 + abs(xi))).all():
                return Solution(xi, y, i + 1, "stayed")
            xi = new
        raise StepFailure(Status.NO_CONVERGENCE, joined.network.name, step.t, step.h)


def test_a_coupling_of_ones_own_gives_the_composed_motion() -> None:
    """A coupling without Newton's method, stepped by the same `Coupled`: states of the composed model, a closed ledger."""
    model = build_model(pair().compose(), Collocated(1))
    one = run(Monolithic(model, PythonInstance(model)), Options(stop=0.3, step=H))
    net = pair()
    two = run(Coupled(net, members(net), Repeated()), Options(stop=0.3, step=H))
    for name in ("m.q", "m.v", "s.e"):
        assert two.column(name) == pytest.approx(one.column(name), abs=1e-13)
    assert two.ledger.summary().closed
    assert two.iterations > 2 * two.steps


def test_where_a_coupling_gives_up_all_members_are_back() -> None:
    net = pair()
    own = members(net)
    stepper = Coupled(net, own, Repeated(trials=1))
    before, last = [m.instance.x for m in own], stepper.last
    with pytest.raises(StepFailure):
        stepper.advance(0.0, H, 1)
    assert all(np.array_equal(m.instance.x, x) for m, x in zip(own, before, strict=True))
    assert stepper.last is last


def test_newton_solves_the_rows_without_a_run() -> None:
    """From the members and a step alone: rows at rounding, members at its end, under the unknowns that are returned."""
    net = pair()
    own = members(net)
    joined = Joined(net, own)
    start = Solution(joined.face.start, np.zeros(len(joined.face.column)))
    found = Newton().solve(joined, start, Step(0.0, H, joined.states()))
    assert found.accepted_by in ("energy", "rounding floor")
    assert abs(joined.rows(found.xi, found.y)).max() <= 1e-13 * abs(found.y).max()
    assert np.array_equal(np.concatenate([m.output() for m in own]), found.y)
    assert [m.instance.time for m in own] == [H, H]


class Silent:
    """A member that tells no numerical loss and not what moved, as units of other tools do."""

    def __init__(self, inner: Any):
        self._inner = inner

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def ledger(self) -> dict[str, Any]:
        return {k: v for k, v in self._inner.ledger().items() if k in ("stored", "dissipated", "supplied", "pairs")}


def test_the_books_of_members_stand_side_by_side() -> None:
    """What a member does not tell: nothing is lost, and all of its energy may have moved."""
    net = pair()
    m, s = members(net)
    parts: list[Any] = [m, Silent(s)]
    joined = Joined(net, parts)
    Newton().solve(
        joined, Solution(joined.face.start, np.zeros(len(joined.face.column))), Step(0.0, H, joined.states())
    )
    book, own = joined.ledger(), m.ledger()
    assert set(book) == {"stored", "dissipated", "supplied", "pairs", "numerical", "moved"}
    assert book["stored"].tolist() == [*own["stored"], *s.ledger()["stored"]]
    assert book["numerical"].tolist() == [0.0, 0.0]
    assert book["moved"].tolist() == [*own["moved"], *abs(s.energies())]
    assert len(book["pairs"]) == len(joined.booking.ports)
