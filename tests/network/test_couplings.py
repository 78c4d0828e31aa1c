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
    StepFailure,
    build_model,
    run,
)
from phfmu.components.mechanical.translational import mass, spring
from phfmu.network.couplings.newton import Newton
from phfmu.network.interface.coupled_members import CoupledMembers

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
        self.iterations = trials

    def moved(self, joined: CoupledMembers, xi: Any, r: Any) -> Any:
        return xi - np.linalg.solve(joined.face.C.toarray(), r)


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


def test_newton_solves_the_rows_of_a_step() -> None:
    """Rows at rounding, members at the end of the step, under the unknowns that are kept."""
    net = pair()
    own = members(net)
    stepper = Coupled(net, own, Newton())
    steps = stepper.advance(0.0, H, 1)
    assert steps.accepted_by is not None and steps.accepted_by[0] in ("energy", "rounding floor")
    y = np.concatenate([m.output() for m in own])
    assert abs(stepper.joined.rows(stepper.last.xi, y)).max() <= 1e-13 * abs(y).max()
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
    stepper = Coupled(net, parts, Newton())
    book, own = stepper.advance(0.0, H, 1), m.ledger()
    assert book.stored[0].tolist() == [*own["stored"], *s.ledger()["stored"]]
    assert book.numerical is not None and book.numerical[0].tolist() == [0.0, 0.0]
    assert book.moved is not None and book.moved[0].tolist() == [*own["moved"], *abs(s.energies())]
    assert len(book.pairs[0]) == len(stepper.joined.booking.ports)
