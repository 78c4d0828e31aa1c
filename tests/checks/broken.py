"""Declarations that break a rule."""

from dataclasses import replace
from typing import Any

import casadi as ca

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Domain,
    Holonomic,
    Network,
    Port,
    algebraic,
    damping,
    energy,
    parameter,
    skew,
    state,
)
from phfmu.components.electrical.machines.synchronous_machine import synchronous_machine
from phfmu.components.electrical.sources import voltage_source
from tests.checks.models import oscillator, resistive


def with_variable(old, **changes: Any) -> PHDAE:
    """The oscillator with a variable changed everywhere."""
    return oscillator().mapped(lambda v: replace(v, **changes) if v is old else v, lambda p: p)


FOREIGN = parameter("mu", 1.0)
OTHER_M = parameter("m", 1.0)
NO_POWER = Domain("broken", "force", "N", "position", "m", "flow")
SCALED = Domain("scaled", "force", "kN", "velocity", "m/s", "flow")


def two_sources() -> PHDAE:
    net = Network("loop")
    net.add("a", voltage_source(1.0))
    net.add("b", voltage_source(2.0))
    net.junction("bus", ["a.terminal", "b.terminal"])
    return net.compose()


def no_conductance() -> PHDAE:
    """A conductance that is given its current and is zero: the voltage is undetermined."""
    v, G = algebraic("v", unit="V"), parameter("G", 0.0, unit="S")
    port = Port("pin", ELECTRICAL, "flow", {v: 1.0}, start=1.0)
    return PHDAE("open", algebraics=(v,), parameters=(G,), dissipation=(damping(v, G),), ports=(port,))


def degenerate() -> PHDAE:
    """q^2 = 0 instead of q = 0."""
    q, v, lam = state("q", unit="m"), state("v", unit="m/s"), algebraic("lambda")
    return PHDAE(
        "wall",
        states=(q, v),
        algebraics=(lam,),
        energies=(energy(0.5 * v.sx**2),),
        structure=(skew(q, v, 1.0),),
        constraints=(Holonomic(lam, q.sx**2),),
    )


def machine(**changes: Any) -> PHDAE:
    """The synchronous machine in current coordinates with a mutated closed-form pair."""
    model = synchronous_machine(coordinates="current")
    pair = model.closed[0]
    new = {k: f(pair) for k, f in changes.items()}
    return replace(model, closed=(replace(pair, **new),))


def machine_with(**changes: Any) -> PHDAE:
    model = synchronous_machine(coordinates="current")
    return replace(model, **{k: f(model) for k, f in changes.items()})


def lonely() -> PHDAE:
    _, _, model = resistive()
    return replace(model, algebraics=(*model.algebraics, algebraic("idle", unit="V")))


def quartic(s: ca.SX) -> ca.SX:
    return 0.25 * s**2
