"""Rows within steps that end at events: the polynomial of each landed step, of order k + 1, never one over an event."""

from __future__ import annotations

from math import cos, pi, sin, sqrt

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq

from phfmu import (
    PHDAE,
    Collocated,
    Guard,
    Jump,
    Monolithic,
    NativeInstance,
    Options,
    StateEvent,
    SwitchedInstance,
    build_model,
    energy,
    parameter,
    run,
    skew,
    state,
    time,
)
from phfmu.cli import main
from phfmu.runs.result import Result
from tests.events.scenes import lifted

G, E, V0 = 9.81, 0.8, 2.0


def ball(stiff: float) -> PHDAE:
    """A ball of 1 kg that is thrown up from a floor, with a spring to it that does not end there."""
    q, p, n = state("q", unit="m"), state("p", unit="kg.m/s", start=V0), parameter("n", 0.0)
    floor = StateEvent(Guard("floor", q, -1, unit="m"), jump=Jump({p: 1.0}, E), when={"n": 0.0}, sets={"n": 1.0})
    again = StateEvent(Guard("again", q, -1, unit="m"), jump=Jump({p: 1.0}, E), when={"n": 1.0}, sets={"n": 2.0})
    return PHDAE(
        "ball", states=(q, p), parameters=(n,), energies=(energy(p**2 / 2), energy(G * q.sx + stiff / 2 * q**2)),
        structure=(skew(q, p, 1.0),), state_events=(floor, again),
    )  # fmt: skip


def thrown(t: float, stiff: float) -> tuple[float, int]:
    """Height of the ball at t and bounces before it, of two."""
    v, begun, bounces = V0, 0.0, 0

    def height(s: float, v: float) -> float:
        if not stiff:
            return v * s - G * s**2 / 2
        w = sqrt(stiff)
        return v / w * sin(w * s) + G / stiff * (cos(w * s) - 1)

    while bounces < 2:
        lasts = (
            2 * v / G
            if not stiff
            else brentq(height, v / G, 1.99 * pi / sqrt(stiff) / 2, args=(v,), xtol=1e-16, rtol=9e-16)
        )
        if t < begun + float(lasts):  # pyright: ignore[reportArgumentType]
            break
        v, begun, bounces = E * v, begun + float(lasts), bounces + 1  # pyright: ignore[reportArgumentType]
    return height(t - begun, v), bounces


def inside_of(result: Result) -> np.ndarray:
    """Which rows lie within steps."""
    assert result.interpolated is not None
    return result.interpolated


def errors(result: Result, stiff: float) -> float:
    """Of the rows within steps; the number of bounces in each is right."""
    inside = inside_of(result)
    exact = [thrown(t, stiff) for t in result.time[inside]]
    assert result.column("n")[inside].tolist() == [n for _, n in exact]
    return float(np.abs(result.column("q")[inside] - [q for q, _ in exact]).max())


@pytest.mark.parametrize("k", (1, 2, 3))
def test_rows_between_bounces_have_order_k_plus_1(k):
    """Every step has its rows, those that were landed too; with constant gravity the polynomial of k >= 2 is the parabola."""
    model, found = build_model(ball(16.0), Collocated(k)), []
    for n in (12, 24):
        result = run(Monolithic(model, NativeInstance(model)), Options(stop=0.64, step=0.64 / n, dense=4))
        assert inside_of(result).sum() == 4 * result.steps and np.isfinite(result.values).all()
        assert result.column("q")[inside_of(result)].min() > 0.0 and (np.diff(result.time) >= 0).all()
        found.append(errors(result, 16.0))
    assert np.log2(found[0] / found[1]) == pytest.approx(k + 1, abs=0.35)
    if k > 1:
        model = build_model(ball(0.0), Collocated(k))
        assert (
            errors(run(Monolithic(model, NativeInstance(model)), Options(stop=0.7, step=0.07, dense=3)), 0.0) <= 1e-14
        )


def test_the_rows_at_step_ends_are_those_of_a_run_without():
    model = build_model(ball(16.0), Collocated(2))
    for rtol in (None, 1e-6):
        plain, dense = (
            run(Monolithic(model, NativeInstance(model)), Options(stop=0.64, step=0.04, dense=n, rtol=rtol))
            for n in (None, 2)
        )
        assert plain.values.tolist() == dense.values[~inside_of(dense)].tolist() and plain.interpolated is None
        assert inside_of(dense).sum() == 2 * dense.steps


LIFT, F0 = 0.3, 15.0


def test_rows_of_switched_models_are_those_of_their_mode():
    """F0 (t - LIFT) pulls the mass, which rests until LIFT; from there on q = F0 (t - LIFT)^3 / 6.

    Of degree 3: exact with k = 3; the force of the floor and the mode are those before it, too.
    """
    model = build_model(lifted(F0 * (ca.SX(time) - LIFT)), Collocated(3))
    result = run(Monolithic(model, SwitchedInstance(model, NativeInstance)), Options(stop=0.7, step=0.07, dense=3))
    inside, t = inside_of(result), result.time
    assert inside.sum() == 3 * result.steps
    np.testing.assert_allclose(result.column("q"), F0 / 6 * np.maximum(t - LIFT, 0.0) ** 3, atol=1e-14)
    np.testing.assert_allclose(result.column("N_end")[inside], F0 * np.maximum(LIFT - t[inside], 0.0), atol=1e-12)
    assert (result.column("rests")[inside] == (t[inside] < LIFT)).all()


def test_the_command_line_writes_them(tmp_path, capsys):
    words = ["run", "bouncing_ball", "--stop", "0.5", "--dense", "2", "--quiet"]
    assert main([*words, "-o", str(tmp_path / "b.csv")]) == 0
    header, *rows = (tmp_path / "b.csv").read_text().splitlines()
    at = header.split(",").index("interpolated")
    inside = sum(float(row.split(",")[at]) == 1 for row in rows)
    assert inside == 2 * 26 and len(rows) == 1 + 26 + inside + 1  # 25 grid steps, one of which a bounce parts
