"""Members stepped apart by a run: node values and impulse pairs make them the composed model, at every order."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Collocated,
    Coupled,
    EngineMember,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    Port,
    PythonInstance,
    Scene,
    StepFailure,
    build_model,
    damping,
    energy,
    run,
    skew,
    state,
)
from phfmu.components.mechanical.translational import mass, spring
from phfmu.components.scenes.electrical.smib import smib
from phfmu.components.scenes.electrical.two_machine import two_machine
from phfmu.network.couplings.coupling import Solution
from phfmu.network.couplings.newton import Continuation, newton
from phfmu.network.couplings.unconverged import AcceptingPolicy
from phfmu.outcome.status import Status
from phfmu.schemes.midpoint import Midpoint
from phfmu.schemes.radau import Radau
from phfmu.schemes.two_level import TwoLevel
from phfmu.signals import CONSTRAINT
from tests.engines import ENGINES
from tests.wide import wide


def members(net: Network, k: int, engine: Any = PythonInstance, **others: Any) -> list[Any]:
    """Member name -> its own k or engine in `others`."""
    out = []
    for name, part in net.members.items():
        own = others.get(name)
        model = build_model(replace(part, name=name), Collocated(own if isinstance(own, int) else k))
        out.append(EngineMember(name, model, (engine if own is None or isinstance(own, int) else own)(model)))
    return out


def smib_scene() -> tuple[Scene, float, float]:
    """A torque step within the run."""
    scene = smib()
    step = replace(scene.events[0], t=3e-3)
    return replace(scene, events=(step,)), 1e-3, 8e-3


def fault_scene() -> tuple[Scene, float, float]:
    """Through a fault and its clearing."""
    return two_machine(t_fault=4e-4, t_clear=12e-4), 2e-4, 2e-3


def both(scene: Scene, h: float, stop: float, k: int, engine: Any, **others: Any) -> tuple[Any, Any]:
    net: Any = scene.system
    model = build_model(scene.declaration(), Collocated(k))
    options = Options(stop=stop, step=h, events=scene.events)
    one = run(Monolithic(model, engine(model)), options)
    return one, run(Coupled(net, members(net, k, engine, **others)), options)


def states_differ(scene: Scene, one: Any, two: Any) -> float:
    """Largest difference of a state over the run relative to its size or nominal value."""
    worst = 0.0
    for v in scene.declaration().states:
        for name, nominal in zip(v.names(), v.nominal, strict=True):
            a, b = one.column(name), two.column(name)
            worst = max(worst, float(np.max(np.abs(a - b)) / max(np.max(np.abs(a)), nominal)))
    return worst


WIDE = pytest.mark.slow
CASES = [
    pytest.param(
        scene, k, engine, marks=() if (k, engine) in quick else WIDE, id=f"{scene.__name__}-{k}-{engine.__name__}"
    )
    for scene, quick in (
        (smib_scene, ((1, PythonInstance),)),
        (fault_scene, ((2, NativeInstance),)),
    )
    for k in (1, 2, 3)
    for engine in ENGINES
]


@pytest.mark.parametrize(("make", "k", "engine"), CASES)
def test_members_are_the_composed_model(make: Any, k: int, engine: Any) -> None:
    """Through events, with Kirchhoff's law at step ends and books that close."""
    scene, h, stop = make()
    one, two = both(scene, h, stop, k, engine)
    assert states_differ(scene, one, two) <= 1e-12
    assert max(v for n, v in two.worst.items() if n.startswith(CONSTRAINT + "velocity.bus1")) <= 1e-9
    assert two.ledger.summary().closed
    assert two.iterations <= 6 * two.steps


def nonlinear() -> Network:
    """A mass with a hardening spring of its own on another spring."""
    q, v, x = state("q", unit="m", start=0.4), state("v", unit="m/s", start=-0.3), state("x", unit="m", start=0.2)
    body = PHDAE(
        "body", (q, v), energies=(energy(2.0 * q.sx**2 + q.sx**4), energy(0.65 * v.sx**2)), E={v: 1.3},
        structure=(skew(q, v, 1.0),), dissipation=(damping(v, 0.2),), ports=(Port("flange", TRANSLATIONAL, "effort", {v: 1.0}),),
    )  # fmt: skip
    net = Network("nonlinear")
    net.add("body", body)
    end = Port("end", TRANSLATIONAL, "flow", {x: 1.0})
    net.add("spring", PHDAE("spring", (x,), energies=(energy(ca.cosh(1.5 * x.sx)),), ports=(end,)))
    net.connect("body.flange", "spring.end", name="joint")
    return net


def exact(end: float) -> np.ndarray:
    """q, v, x of `nonlinear` by another method."""

    def rate(_: float, s: Any) -> list[float]:
        q, v, x = s
        return [v, (-(4 * q + 4 * q**3) - 0.2 * v - 1.5 * np.sinh(1.5 * x)) / 1.3, v]

    return solve_ivp(rate, (0.0, end), [0.4, -0.3, 0.2], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


@pytest.mark.parametrize(
    ("k", "others", "order"),
    [
        pytest.param(1, {}, 2, marks=WIDE),
        pytest.param(2, {}, 4, marks=WIDE),
        (2, {"spring": NativeInstance}, 4),
        pytest.param(3, {"spring": 2}, 4, marks=WIDE),
        pytest.param(3, {}, 6, marks=WIDE),
        pytest.param(3, {"body": 1}, 2, marks=WIDE),
    ],
)
def test_the_order_is_that_of_the_least_member(k: int, others: dict[str, Any], order: int) -> None:
    """Also where members have other orders, or other engines; the books close whatever is exchanged."""
    errors, steps = [], [0.2, 0.1, 0.05]
    for h in steps:
        net = nonlinear()
        result = run(Coupled(net, members(net, k, **others)), Options(stop=1.0, step=h))
        x = [result.column(n)[-1] for n in ("body.q", "body.v", "spring.x")]
        errors.append(np.max(np.abs(x - exact(1.0))))
        assert result.ledger.summary().closed
        assert result.iterations <= 6 * result.steps
    slopes = np.diff(np.log(errors)) / np.diff(np.log(steps))
    assert slopes == pytest.approx([order] * 2, abs=0.35)


@pytest.mark.parametrize("others", [{}, {"gen": 3}, {"line": 3}])
def test_of_an_iteration_stopped_early_the_junctions_take_what_rows_and_impulses_say(others: dict[str, int]) -> None:
    """W by the theorem against the books of the members, also where these have other nodes than their junctions."""
    net: Any = smib().system
    for seed in range(3):
        stepper = Coupled(net, members(net, 2, **others), lambda joined: AcceptingPolicy(newton(joined)))
        exchange: Any = stepper.coupling.inner.exchange  # type: ignore[attr-defined]
        assert exchange.k.tolist() == [2] * len(exchange.k) and len(exchange.bare) == 3
        assert [stepper.joined.face.names[c].partition(".")[0] for c in exchange.bare] == ["bus1"] * 3
        stepper.master.rules.iterations = 1
        nominal, h, rng = stepper.joined.face.nominal, 1e-3, np.random.default_rng(seed)
        xi = nominal[exchange.columns] * rng.normal(size=len(exchange.columns))
        m = 1e-2 * h * nominal[exchange.bare] * rng.normal(size=(2, 3))
        stepper.last = Solution(stepper.last.xi, None, h, Continuation(np.concatenate([xi, *m])))
        steps, _ = stepper.master.advance(stepper.last, stepper._sums, (0.0, h, 0), 1)
        assert steps.works is not None and steps.accepted_by is not None and steps.accepted_by[0] == "unconverged"
        ports = [i for i, p in enumerate(stepper.joined.booking.ports) if p.junction]
        pairs = steps.pairs[0, ports]
        assert abs(pairs.sum()) > 1e-3 * np.abs(pairs).sum()
        assert steps.works.sum() == pytest.approx(pairs.sum(), rel=1e-11)


@pytest.mark.parametrize("stiffness", wide([1e2, 1e6, 1e10], 1e10))
def test_a_stiff_spring_without_force_is_solved_to_rounding(stiffness: float) -> None:
    """Two equal masses that move together: the force between them is only rounding, its rows never get small against it."""
    w = 2 * np.pi
    net = Network("twins")
    for name in "ab":
        net.add(name, mass(1.0, k=w**2, q=1.0))
    net.add("s", spring(stiffness))
    net.connect("a.flange", "s.a", name="left")
    net.connect("b.flange", "s.b", name="right")
    result = run(Coupled(net, members(net, 2)), Options(stop=0.2, step=0.01))
    assert np.allclose(result.column("a.q"), np.cos(w * result.time), rtol=0, atol=1e-6)
    H = np.sum([result.column(f"{m}.energy.stored") for m in "abs"], axis=0)
    assert np.abs(H / H[0] - 1).max() <= 1e-13
    assert abs(sum(j.residual for j in result.ledger.summary().junctions)) <= 1e-13 * H[0]


def test_a_step_that_fails_brings_impulses_and_unknowns_back() -> None:
    net: Any = smib().system
    own = members(net, 2)
    stepper = Coupled(net, own)
    stepper.advance(0.0, 1e-3, 2)
    before, last = [m.instance.get_state() for m in own], stepper.last
    H = stepper.energies()
    step, trials = own[1].do_step, []

    def fails(t: float, h: float) -> None:
        """The second trial, after the others have stepped."""
        step(t, h)
        trials.append(t)
        if len(trials) == 2:
            raise StepFailure(Status.NO_CONVERGENCE, "line", t, h)

    own[1].do_step = fails
    with pytest.raises(StepFailure):
        stepper.advance(2e-3, 4e-3, 1)  # longer than before: more than one trial
    own[1].do_step = step
    assert len(trials) == 2 and stepper.last is last and np.array_equal(stepper.energies(), H)
    for m, s in zip(own, before, strict=True):
        assert np.array_equal(m.instance.get_state().x, s.x) and np.array_equal(
            m.instance.get_state().impulses, s.impulses
        )
    found = stepper.advance(2e-3, 4e-3, 1)
    assert len(found.H) == 1


def test_members_under_other_schemes_are_held() -> None:
    """The midpoint baseline is a kind of `Collocated`, but keeps no order 2k."""
    assert Collocated(3).node_values and TwoLevel(3).node_values and Radau(2).node_values
    assert not Midpoint().node_values
