"""Members with holonomic constraints, stepped apart by the two-level scheme with values at the nodes of its steps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Collocated,
    Coupled,
    EngineMember,
    FMUInstance,
    FMUMember,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    Port,
    PythonInstance,
    build_model,
    energy,
    export,
    run,
    state,
)
from phfmu.components.mechanical.multibody import Multibody
from phfmu.network.couplings.choice.partitioned_network import PartitionedNetwork
from phfmu.network.couplings.newton import newton
from phfmu.schemes.two_level import TwoLevel
from tests.wide import slow

STOP = 0.4


def swing(*, damped: bool = False, massless: bool = False, twice: bool = False, moving: bool = False) -> PHDAE:
    """Two links that hang from a support: damped, their joint without mass, a link given twice, the support led along."""
    body = Multibody("swing", dim=2)
    elbow, tip = body.particle(1.0, [0.8, -0.6]), body.particle(0.0 if massless else 0.7, [1.6, -1.2])
    led = body.moving_support("led", lambda t: [0.02 * (1 - ca.cos(3 * t)), 0.0])
    top = led if moving else body.support([0.0, 0.0])
    body.bar(elbow, top)
    body.bar(elbow, tip)
    if twice:
        body.bar(elbow, top)
    if damped:
        body.damper(tip, body.support([2.0, 0.0]), 0.5)
    if massless:
        body.bar(tip, body.support([2.2, -0.3]))
    body.port("tip", elbow if massless else tip)
    return body.build()


def hung(**kind: bool) -> Network:
    """Its tip on a spring that is not linear."""
    e = state("e", 2, unit="m", start=[0.3, 0.1], nominal=1.0)
    s = ca.sumsqr(e.sx)
    pull = Port("b", TRANSLATIONAL, "flow", {e: np.eye(2)}, 2)
    net = Network("hung")
    net.add("swing", swing(**kind))
    net.add("spring", PHDAE("spring", states=(e,), energies=(energy(10.0 * s + 5.0 * s**2),), ports=(pull,)))
    net.connect("swing.tip", "spring.b", name="j")
    return net


def rigid() -> Network:
    """Its tip on a mass, rigidly: the force between them is an unknown of the network."""
    other = Multibody("other", dim=2)
    p = other.particle(1.3, [1.6, -1.2])
    other.linear_spring(p, other.support([2.0, 0.0]), 20.0, 0.5)
    other.port("tip", p)
    net = Network("rigid")
    net.add("swing", swing())
    net.add("other", other.build())
    net.junction("j", ["swing.tip", "other.tip"], kind="1")
    return net


def models(net: Network, k: int) -> dict[str, Any]:
    return {n: build_model(d, TwoLevel(k) if d.constraints else Collocated(k)) for n, d in net.declared.items()}


def whole(net: Network, k: int, h: float, engine: Callable[[Any], Any] = NativeInstance) -> Any:
    model = build_model(net.compose(), TwoLevel(k))
    return run(Monolithic(model, engine(model)), Options(stop=STOP, step=h))


def apart(net: Network, k: int, h: float, engine: Callable[[Any], Any] = NativeInstance) -> Any:
    own: list[Any] = [EngineMember(n, m, engine(m)) for n, m in models(net, k).items()]
    return run(Coupled(net, own, newton), Options(stop=STOP, step=h))


def states(result: Any) -> np.ndarray[Any, Any]:
    names = ("swing.q", "swing.v", "spring.e", "other.q", "other.v")
    kept = [n for n in result.names if n.split("[")[0] in names]
    assert len(kept) >= 8
    return np.array([result.column(n) for n in sorted(kept)])


CASES = [
    (hung, 3, PythonInstance),
    *(
        slow(case)
        for case in [
            (hung, 1, NativeInstance),
            (hung, 3, NativeInstance),
            (rigid, 1, NativeInstance),
            (rigid, 3, NativeInstance),
            (lambda: hung(damped=True), 3, NativeInstance),
            (lambda: hung(massless=True), 3, NativeInstance),
            (lambda: hung(twice=True), 3, NativeInstance),
            (lambda: hung(moving=True), 3, NativeInstance),
        ]
    ),
]


@pytest.mark.parametrize(("network", "k", "engine"), CASES)
def test_two_level_members_are_equal_to_the_composed_model(network: Callable[[], Network], k: int, engine: Any) -> None:
    """With k = 3 they took one held value before, off by 1e-2; what the junction makes is rounding."""
    net = network()
    assert PartitionedNetwork(net).exchanged()["j"] == "k values, order 2k"
    one, two = apart(net, k, 0.05, engine), whole(net, k, 0.05, engine)
    found, expected = states(one), states(two)
    assert np.abs(found - expected).max() <= 1e-12 * max(1.0, np.abs(expected).max())
    summary = one.ledger.summary()
    assert summary.closed and abs(summary.junctions[0].residual) <= 1e-12 * summary.components[0].H_end


@pytest.mark.slow
def test_two_level_members_keep_order_six() -> None:
    net = hung(damped=True)
    reference = states(whole(net, 3, STOP / 400))[:, -1]
    errors = [np.abs(states(apart(net, 3, h))[:, -1] - reference).max() for h in (0.1, 0.05, 0.025)]
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(6.0, abs=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_two_level_units_take_inputs_at_nodes(tmp_path: Path, version: str) -> None:
    net, own = hung(), []
    for n, m in models(net, 3).items():
        (path,) = export(m, tmp_path, (version,), step=0.05, node_inputs=True)
        own.append(FMUMember(n, FMUInstance(path)))
    found = states(run(Coupled(net, own, newton), Options(stop=STOP, step=0.05)))
    expected = states(whole(net, 3, 0.05))
    assert np.abs(found - expected).max() <= 1e-12 * max(1.0, np.abs(expected).max())
