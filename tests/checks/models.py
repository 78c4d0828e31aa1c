"""Small sound models."""

from dataclasses import replace
from typing import Any

import casadi as ca

from phfmu import (
    ELECTRICAL,
    PHDAE,
    TRANSLATIONAL,
    Block,
    Holonomic,
    Network,
    Port,
    algebraic,
    block,
    check,
    damping,
    energy,
    observable,
    parameter,
    skew,
    state,
)
from phfmu.components.electrical.rl_line import rl_line

Q, V = state("q", unit="m", start=0.3), state("v", unit="m/s", start=-0.2)
M, K, D = parameter("m", 2.0, unit="kg"), parameter("k", 5.0, unit="N/m"), parameter("d", 0.4, unit="N.s/m")
FORCE = Port("flange", TRANSLATIONAL, "effort", {V: 1.0})


def oscillator(**changes: Any) -> PHDAE:
    """A mass on a spring with a damper and a port."""
    base = PHDAE(
        "oscillator",
        states=(Q, V),
        parameters=(M, K, D),
        energies=(energy(0.5 * M * V.sx**2), energy(0.5 * K * Q.sx**2)),
        E={V: M},
        structure=(skew(Q, V, 1.0),),
        dissipation=(damping(V, D),),
        ports=(FORCE,),
        observables=(observable("power", V.z * FORCE.u, unit="W"),),
        z={V: V},
    )
    return replace(base, **changes)


def resistive() -> tuple[Any, Any, PHDAE]:
    """A resistor with given voltage: 0 = -v + u, 0 = i - G v."""
    i, v, G = algebraic("i", unit="A"), algebraic("v", unit="V"), parameter("G", 0.1, unit="S")
    model = PHDAE(
        "resistor",
        algebraics=(i, v),
        parameters=(G,),
        structure=(skew(v, i, 1.0),),
        dissipation=(damping(v, G),),
        ports=(Port("pin", ELECTRICAL, "effort", {i: 1.0}),),
    )
    return i, v, model


def rules(model: PHDAE) -> list[str]:
    return [p.rule for p in check(model)]


def two_lines(current: float) -> PHDAE:
    """Two lines that meet at a bare node: the currents must sum to zero."""
    net = Network("node")
    net.add("a", rl_line(1.0, 1e-2, i=(1.0, -0.5, -0.5)))
    net.add("b", rl_line(1.0, 1e-2, i=(current, -0.5, 0.5 - current)))
    net.junction("bus", ["a.b", "b.a"])
    return net.compose()


def holonomic(structure: tuple[Block, ...], E=None) -> PHDAE:
    """A particle on a circle."""
    q, v = state("r", 2, unit="m", start=[1.0, 0.0]), state("w", 2, unit="m/s", start=[0.0, 1.0])
    lam = algebraic("lambda", unit="N/m")
    build = {
        "unit": lambda: skew(q, v, 1.0),
        "double": lambda: skew(q, v, 2.0),
        "none": lambda: block([q], ca.SX(2, 2)),
    }
    turning = ca.SX(2, 2)
    turning[0, 1], turning[1, 0] = 1 + q[0], -1 - q[0]
    build["varying"] = lambda: skew(q, v, ca.SX.eye(2) * (1 + q[1] ** 2))
    build["turning"] = lambda: block([q], turning)
    return PHDAE(
        "circle",
        states=(q, v),
        algebraics=(lam,),
        energies=(energy(0.5 * ca.sumsqr(v.sx)),),
        E={q: 2.0} if E else {},
        structure=tuple(build[s]() for s in structure),
        constraints=(Holonomic(lam, ca.SX(0.5 * (ca.sumsqr(q.sx) - 1.0))),),
    )


def source(expr) -> PHDAE:
    i, _, model = resistive()
    return replace(model, ports=(Port("pin", ELECTRICAL, "effort", {i: 1.0}, source=expr(i)),))
