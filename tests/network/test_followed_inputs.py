"""Inputs of members stepped apart that follow data: at the nodes of their steps, in native and Python loops and in units."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    Anderson,
    Collocated,
    Coupled,
    EngineMember,
    FMUInstance,
    FMUMember,
    Jacobi,
    Monolithic,
    NativeInstance,
    Options,
    PythonInstance,
    build_model,
    export,
    run,
)
from phfmu.cli import main
from phfmu.components.scenes.drive import drive
from phfmu.network.couplings.newton import Newton, newton
from tests.network.both_loops import called_back
from tests.wide import wide

STOP = 0.02
TIME = np.linspace(0.0, STOP, 5)
STATES = ("motor.flux", "motor.w", "shaft.twist", "load.w")


def volts(t: Any) -> Any:
    """A cubic polynomial: the spline through rows of it is the same."""
    s = t / STOP
    return 12.0 + 9.0 * s - 30.0 * s**2 + 15.0 * s**3


ROWS = {"time": TIME, "motor.terminal.v": volts(TIME)}


def whole(k: int, h: float, kind: str, engine: Any) -> Any:
    model = build_model(drive().system.compose(), Collocated(k))
    return run(Monolithic(model, engine(model)), Options(stop=STOP, step=h), inputs=ROWS, interpolate=kind)


def coupled(k: int, engine: Any, coupling: Any = newton, called: bool = False) -> Coupled:
    models = {n: build_model(d, Collocated(k)) for n, d in drive().system.members.items()}
    own: list[Any] = [EngineMember(n, m, engine(m)) for n, m in models.items()]
    return called_back(Coupled(drive().system, own, coupling), called)


def states(result: Any) -> np.ndarray[Any, Any]:
    return np.array([result.column(n) for n in STATES])


CASES = [
    (PythonInstance, 2, "cubic", False),
    *((NativeInstance, k, kind, c) for k in (1, 2, 3) for kind in ("linear", "cubic") for c in (True, False)),
]


@pytest.mark.parametrize(("engine", "k", "kind", "called"), wide(CASES, CASES[0]))
def test_members_apart_follow_data_as_the_composed_model(engine: Any, k: int, kind: str, called: bool) -> None:
    """To rounding, also of members that are called back; every joule is booked, and columns tell the data."""
    h = STOP / 20
    own = coupled(k, engine, called=called)
    one = run(own, Options(stop=STOP, step=h), inputs=ROWS, interpolate=kind)
    two = whole(k, h, kind, engine)
    expected = states(two)
    assert np.abs(states(one) - expected).max() <= 1e-13 * np.abs(expected).max()
    np.testing.assert_array_equal(one.column("motor.terminal.v"), two.column("motor.terminal.v"))
    summary = one.ledger.summary()
    assert summary.closed and own.followed is None
    work = {p.port: p.supplied for p in summary.ports if p.component == "motor"}
    again = {p.port: p.supplied for p in two.ledger.summary().ports if p.component == "motor"}
    assert work["terminal"] == pytest.approx(again["terminal"], rel=1e-12)


def by_hand() -> np.ndarray[Any, Any]:
    """The equations of the drive as they stand in the pages of its parts, by another integrator."""
    p = {f"{n}.{v.name}": v.start[0] for n, d in drive().system.members.items() for v in d.parameters}

    def rates(t: float, x: Any) -> list[float]:
        flux, w, twist, speed = x
        torque = p["shaft.c"] * twist + p["shaft.d"] * (speed - w)
        i = flux / p["motor.L"]
        return [
            volts(t) - p["motor.R"] * i - p["motor.k"] * w,
            (p["motor.k"] * i - p["motor.d"] * w + torque) / p["motor.J"],
            speed - w,
            (-p["load.d"] * speed - torque) / p["load.J"],
        ]

    return solve_ivp(rates, (0.0, STOP), np.zeros(4), "DOP853", rtol=1e-13, atol=1e-16).y[:, -1]


def slope(make: Callable[[], Coupled], n: int) -> float:
    reference, errors = by_hand(), []
    for h in (STOP / n, STOP / (2 * n)):
        result = run(make(), Options(stop=STOP, step=h), inputs=ROWS, interpolate="cubic")
        errors.append(np.abs((states(result)[:, -1] - reference) / reference).max())
    return float(np.log2(errors[0] / errors[1]))


@pytest.mark.parametrize(("k", "n"), wide([(1, 40), (2, 20), (3, 10)]))
def test_the_order_of_members_apart_is_kept(k: int, n: int) -> None:
    assert slope(lambda: coupled(k, PythonInstance), n) == pytest.approx(2 * k, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("coupling", "order"), [(lambda _: Newton(), 2), (lambda _: Anderson(), 2), (lambda _: Jacobi(), 1)]
)
def test_inputs_that_are_held_have_their_value_in_the_middle(coupling: Any, order: int) -> None:
    """What members take one of a step is of order 2."""
    assert slope(lambda: coupled(2, NativeInstance, coupling), 80) == pytest.approx(order, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_units_follow_data_at_their_nodes(tmp_path: Path, version: str) -> None:
    own, h = [], STOP / 20
    for name, d in drive().system.members.items():
        (path,) = export(build_model(d, Collocated(2)), tmp_path / name, (version,), step=h, node_inputs=True)
        own.append(FMUMember(name, FMUInstance(path)))
    result = run(Coupled(drive().system, own, newton), Options(stop=STOP, step=h), inputs=ROWS, interpolate="cubic")
    expected = states(whole(2, h, "cubic", NativeInstance))
    assert np.abs(states(result) - expected).max() <= 1e-12 * np.abs(expected).max()


@pytest.mark.slow
def test_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "volts.csv").write_text(
        "time,motor.terminal.v\n" + "".join(f"{t!r},{volts(t)!r}\n" for t in TIME.tolist())
    )
    line = ["run", "drive", "--order", "4", "--stop", str(STOP), "--input", str(tmp_path / "volts.csv")]
    line += ["--interpolate", "cubic", "--audit", "none", "--quiet", "-o"]
    columns = []
    for name, options in (("whole", []), ("apart", ["--coupling", "newton"])):
        assert main([*line, str(tmp_path / f"{name}.csv"), *options]) == 0
        table = np.genfromtxt(tmp_path / f"{name}.csv", delimiter=",", names=True, deletechars="")
        columns.append(
            np.array([table[n.replace(".", "_")] if n not in table.dtype.names else table[n] for n in STATES])
        )
    assert np.abs(columns[0] - columns[1]).max() <= 1e-12 * np.abs(columns[0]).max()
