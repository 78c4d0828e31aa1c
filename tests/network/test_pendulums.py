"""Two pendulums on a torsion spring: nonlinear members joined by repeated steps, at any stiffness of the spring."""

from __future__ import annotations

from typing import Any

import casadi as ca
import pytest

from phfmu import (
    PHDAE,
    ROTATIONAL,
    Anderson,
    Coupled,
    EngineMember,
    NativeInstance,
    Network,
    Options,
    Port,
    build_model,
    energy,
    run,
    skew,
    state,
)
from phfmu.network.couplings.newton import Newton
from tests.wide import wide

G = 9.81


def pendulum(name: str, q0: float) -> PHDAE:
    """m = l = 1: H = w^2/2 + g (1 - cos q),  q' = w,  w' = -g sin q + torque."""
    q, w = state("q", unit="rad", start=q0), state("w", unit="rad/s")
    return PHDAE(
        name, states=(q, w), energies=(energy(G * (1 - ca.cos(q.sx))), energy(0.5 * w.sx**2)), structure=(skew(q, w, 1.0),),
        ports=(Port("shaft", ROTATIONAL, "effort", {w: 1.0}),),
    )  # fmt: skip


def torsion(k: float, twist: float) -> PHDAE:
    e = state("e", unit="rad", start=twist)
    ports = (Port("a", ROTATIONAL, "flow", {e: -1.0}), Port("b", ROTATIONAL, "flow", {e: 1.0}))
    return PHDAE("torsion", states=(e,), energies=(energy(0.5 * k * e.sx**2),), ports=ports)


def pendulums(k: float) -> Any:
    net = Network("pendulums")
    net.add("one", pendulum("one", 2.5))
    net.add("two", pendulum("two", 0.0))
    net.add("spring", torsion(k, -2.5))
    net.connect("one.shaft", "spring.a", name="left")
    net.connect("two.shaft", "spring.b", name="right")
    return net


@pytest.mark.parametrize("k", wide([10.0, 1e4, 1e8], 1e8))
@pytest.mark.parametrize("kind", wide(["newton", "anderson"], "newton"))
def test_the_energy_is_kept_over_2000_steps(k: float, kind: str) -> None:
    net = pendulums(k)
    models = {n: build_model(d) for n, d in net.members.items()}
    members: list[Any] = [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()]
    coupling = Newton() if kind == "newton" else Anderson()
    steps = 2000 if kind == "newton" else 300
    result = run(Coupled(net, members, coupling), Options(stop=0.01 * steps, step=0.01))
    s = result.ledger.summary()
    H0 = sum(c.H_start for c in s.components)
    assert H0 == pytest.approx(G * (1 - float(ca.cos(2.5))) + k * 2.5**2 / 2)
    assert s.network is not None and abs(s.network.stored) <= 1e-11 * H0
    trials = result.iterations / result.steps
    assert trials <= (4.5 if kind == "newton" else 12.0), trials
