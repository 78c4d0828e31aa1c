"""Error-controlled steps: proportional errors, exact landing, exact restore, closed ledgers."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    PHDAE,
    Collocated,
    DeclarationError,
    Event,
    Monolithic,
    NativeInstance,
    Options,
    PythonInstance,
    Radau,
    algebraic,
    block,
    build_model,
    damping,
    default_scheme,
    energy,
    parameter,
    run,
    skew,
    state,
)
from phfmu.components.library import build
from phfmu.runs.march.adaptive import ToleranceMissed
from tests.engines import ENGINES
from tests.wide import wide

TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)


def stepper(declaration, scheme, engine=NativeInstance):
    model = build_model(declaration, scheme)
    return Monolithic(model, engine(model))


def circuit() -> PHDAE:
    """q' = phi - i, phi' = -v - phi/20, 0 = v - r i, H = q^2/2 + q^4/8 + phi^2/2; index 1; r is a parameter."""
    q, phi, i = state("q", start=0.9), state("phi", start=-0.4), algebraic("i", start=0.5)
    r = parameter("r", 8.0)
    return PHDAE(
        "circuit", states=(q, phi), algebraics=(i,), parameters=(r,),
        energies=(energy(q**2 / 2 + q**4 / 8), energy(phi**2 / 2)),
        structure=(skew(q, phi, 1.0), skew(q, i, -1.0)), dissipation=(damping(phi, 0.05), block([i], r)),
    )  # fmt: skip


def circuit_at(t, x, t0, r):
    """The state at t by DOP853 from x at t0."""

    def rate(_, x):
        v = x[0] + x[0] ** 3 / 2
        return [x[1] - v / r, -v - x[1] / 20]

    return solve_ivp(rate, (t0, t), x, method="DOP853", rtol=3e-14, atol=1e-16).y[:, -1]


@cache
def circuit_end():
    return circuit_at(10.0, (0.9, -0.4), 0.0, 8.0)


@cache
def four_end():
    instance = NativeInstance(build_model(build("four_particle"), default_scheme(build("four_particle"), 6)))
    instance.run(0.0, 1.0 / 4000, 4000)
    return instance.x


FOUR, CIRCUIT = (lambda: build("four_particle"), four_end, 1.0), (circuit, circuit_end, 10.0)
#: model, reference and end; scheme; tolerances; largest error / tolerance
CASES = {
    "four_particle, order 2": (FOUR, lambda d: default_scheme(d, 2), TOLERANCES[1:4], 3.0),
    "four_particle, order 6": (FOUR, lambda d: default_scheme(d, 6), TOLERANCES, 0.5),
    "circuit, order 2": (CIRCUIT, lambda d: Collocated(1), TOLERANCES[:3], 1.0),
    "circuit, order 4": (CIRCUIT, lambda d: Collocated(2), TOLERANCES, 0.3),
    "circuit, order 6": (CIRCUIT, lambda d: Collocated(3), TOLERANCES, 0.1),
    "circuit, radau 3": (CIRCUIT, lambda d: Radau(2), TOLERANCES, 1.0),
    "circuit, radau 5": (CIRCUIT, lambda d: Radau(3), TOLERANCES, 1.0),
}


@pytest.mark.parametrize("case", wide(CASES, "circuit, order 4"))
def test_the_error_is_proportional_to_the_tolerance_and_of_its_size(case):
    (declaration, exact, stop), scheme, tolerances, bound = CASES[case]
    d = declaration()
    s, errors = stepper(d, scheme(d)), []
    for rtol in tolerances:
        s.instance.reset()
        result = run(s, Options(stop=stop, step=0.01, rtol=rtol))
        x = exact()
        errors.append(float(np.max(np.abs(s.instance.x - x) / (1 + np.abs(x)))))
        book = result.ledger.summary().components[0]
        assert abs(book.worst_residual) < 1e-13 * (abs(book.H_start) + abs(book.stored))
        assert result.time[-1] == stop
    assert np.polyfit(np.log(tolerances), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.15)
    # the tolerance is one per step; global errors are of its size
    assert max(np.array(errors) / tolerances) < bound


@pytest.mark.parametrize("k", [1, 2])
def test_both_engines_take_the_same_steps_bit_for_bit(k):
    times = [run(stepper(circuit(), Collocated(k), e), Options(stop=1.0, step=0.01, rtol=1e-4)).time for e in ENGINES]
    assert np.array_equal(*times)


@pytest.mark.parametrize("engine", ENGINES)
def test_rejected_steps_leave_no_trace(engine):
    """The accepted steps, taken again without control, give the same bits."""
    s = stepper(circuit(), Collocated(2), engine)
    result = run(s, Options(stop=2.0, step=0.7, rtol=1e-6))
    assert result.rejected > 0
    plain = engine(build_model(circuit(), Collocated(2)))
    for t, end in zip(result.time[:-1], result.time[1:], strict=True):
        plain.do_step(t, end - t)
    assert np.array_equal(plain.x, s.instance.x)


EVENTS = [Event(0.1, "r", 1.3), Event(1 / 3, "r", 0.2), Event(0.7000000000000001, "r", 0.9)]


@pytest.mark.parametrize("rtol", [1e-3, 1e-7])
def test_events_and_communication_points_are_landed_on_to_the_last_bit(rtol):
    s = stepper(circuit(), Collocated(2))
    result = run(s, Options(stop=1.0, step=0.05, rtol=rtol, events=EVENTS, landing=0.05))
    assert {*(e.t for e in EVENTS), 0.05, 0.1 + 0.05, 1 / 3 + 7 * 0.05, 1.0} <= set(result.time)
    assert (np.diff(result.time) > 0).all()
    x, ends = np.array([0.9, -0.4]), [0.0, *(e.t for e in EVENTS), 1.0]
    for t0, t, r in zip(ends[:-1], ends[1:], [8.0, *(e.value for e in EVENTS)], strict=True):
        x = circuit_at(t, x, t0, r)
    assert np.abs(s.instance.x - x).max() < rtol


def stiff(G=0.0) -> PHDAE:
    """A slow oscillator (1 rad/s) with a fast RC beside it: G = 1 gives 14 us."""
    q, phi, c = state("q", start=1.0), state("phi", start=0.0), state("c", start=1.0)
    g = parameter("G", G)
    return PHDAE(
        "stiff", states=(q, phi, c), parameters=(g,),
        energies=(energy(q**2 / 2), energy(phi**2 / 2), energy(c**2 / 2)),
        structure=(skew(q, phi, 1.0),), dissipation=(damping(c, g / 14e-6),),
    )  # fmt: skip


@pytest.mark.parametrize("restart", [0, 1])
def test_the_step_shrinks_for_a_transient_and_grows_when_it_has_died_out(restart):
    s = stepper(stiff(), Collocated(2))
    result = run(s, Options(stop=5.0, step=0.01, rtol=1e-5, events=[Event(1.0, "G", 1.0)], restart=restart))
    h, t = np.diff(result.time), result.time[:-1]
    assert h[t < 1.0].max() > 0.05
    assert h[t >= 1.0].min() < 14e-6
    assert h[t > 1.1].min() > 0.02
    x = s.instance.x
    assert np.abs(x[:2] - [np.cos(5.0), -np.sin(5.0)]).max() < 1e-4
    assert abs(x[2]) < 1e-4
    (c,) = result.ledger.summary().components
    assert c.worst_relative < 1e-14
    assert (c.numerical is not None) == bool(restart)


def test_limits_of_the_step_are_kept_and_a_missed_tolerance_names_the_state():
    s = stepper(circuit(), Collocated(2))
    result = run(s, Options(stop=1.0, step=0.01, rtol=1e-3, max_step=0.03))
    assert result.largest <= 0.03
    s = stepper(stiff(), Collocated(2))
    with pytest.raises(ToleranceMissed, match=r"state c\b.*--min-step"):
        run(s, Options(stop=2.0, step=0.01, rtol=1e-6, events=[Event(1.0, "G", 1.0)], min_step=1e-3))
    assert s.instance.time == 1.0


def test_what_does_not_fit_says_what_does():
    four = build("four_particle")
    with pytest.raises(DeclarationError, match="--scheme two-level"):
        run(stepper(four, Collocated(1), PythonInstance), Options(stop=1.0, step=0.01, rtol=1e-3))
    for arguments in (
        {"rtol": 0.0},
        {"rtol": float("nan")},
        {"rtol": 1e-3, "atol": 2.0},
        {"rtol": 1e-3, "min_step": 1.0, "max_step": 0.1},
    ):
        with pytest.raises(ValueError, match="--"):
            run(stepper(circuit(), Collocated(1), PythonInstance), Options(stop=1.0, step=0.01, **arguments))


@pytest.mark.slow
def test_the_error_of_a_machine_at_a_grid_is_proportional_to_the_tolerance():
    """smib at its 60 Hz against the independent reference; landed on 0.1 s."""
    scene, tolerances, errors = build("smib"), (1e-4, 1e-5, 1e-6, 1e-7), []
    text = (Path(__file__).parents[1] / "reference" / "smib.csv").read_text().splitlines()
    header, *rows = (line.split(",") for line in text if not line.startswith("#"))
    row = next(dict(zip(header, map(float, r), strict=True)) for r in rows if abs(float(r[0]) - 0.2) < 1e-9)
    model = build_model(scene.declaration(), Collocated(3))
    for rtol in tolerances:
        s = Monolithic(model, NativeInstance(model))
        result = run(s, Options(stop=0.2, step=1e-4, rtol=rtol, landing=0.1))
        currents = [result.column(f"gen.I[{i}]")[-1] - row[f"I[{i}]"] for i in (1, 2, 3)]
        errors.append(np.max(np.abs(currents)) / 15e3)
        assert max(c.worst_relative for c in result.ledger.summary().components) < 1e-13
        assert 0.1 in result.time
    assert np.polyfit(np.log(tolerances), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.15)
    assert max(np.array(errors) / tolerances) < 0.5
