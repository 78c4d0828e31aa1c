"""Rows between step ends: exact at the ends, order k + 1 between them, marked."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    PHDAE,
    Collocated,
    Event,
    Monolithic,
    NativeInstance,
    Options,
    PythonInstance,
    Radau,
    build_model,
    default_scheme,
    energy,
    run,
    skew,
    state,
)
from phfmu.cli import main
from phfmu.components.library import build
from phfmu.runs.dense import polynomial_of
from tests.engines import ENGINES
from tests.wide import wide


def oscillator() -> PHDAE:
    """q' = p, p' = -q - q^3."""
    q, p = state("q", start=1.0), state("p", start=0.2)
    return PHDAE(
        "osc", states=(q, p), energies=(energy(q**2 / 2 + q**4 / 4), energy(p**2 / 2)), structure=(skew(q, p, 1.0),)
    )


def stepper(declaration, scheme, engine=PythonInstance):
    model = build_model(declaration, scheme)
    return Monolithic(model, engine(model))


@pytest.mark.parametrize(
    ("scheme", "order"), [(Collocated(1), 2), (Collocated(2), 3), (Collocated(3), 4), (Radau(2), 3)], ids=str
)
def test_rows_between_the_ends_have_order_k_plus_1(scheme, order):
    errors = []
    for n in (20, 40):
        result = run(stepper(oscillator(), scheme), Options(stop=2.0, step=2.0 / n, dense=4))
        exact = solve_ivp(lambda _, x: [x[1], -x[0] - x[0] ** 3], (0, 2), (1.0, 0.2), method="DOP853", rtol=1e-13, atol=1e-14,
                          t_eval=np.minimum(result.time, 2.0))  # fmt: skip
        assert len(result.time) == 5 * n + 1
        assert result.interpolated.sum() == 4 * n
        states = np.column_stack([result.column("q"), result.column("p")])
        errors.append(np.abs(states - exact.y.T)[result.interpolated].max())
        stored = states[:, 0] ** 2 / 2 + states[:, 0] ** 4 / 4 + states[:, 1] ** 2 / 2
        assert result.column("energy.stored") == pytest.approx(stored, rel=1e-14)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.3)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", wide(["four_particle", "two_machine"], "four_particle"))
def test_the_rows_at_step_ends_are_those_of_a_run_without(name, engine):
    made = build(name)
    d, h = (made, 0.01) if isinstance(made, PHDAE) else (made.declaration(), made.step)
    plain, dense = (run(stepper(d, default_scheme(d), engine), Options(stop=4 * h, step=h, dense=n)) for n in (None, 2))
    ends = ~dense.interpolated
    assert plain.interpolated is None
    assert np.array_equal(dense.time[ends], plain.time)
    assert np.array_equal(dense.values[ends], plain.values)
    assert np.isfinite(dense.values).all()
    assert (np.diff(dense.time) > 0).all()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("order", [2, 6])
def test_the_polynomial_ends_where_the_step_ends(engine, order):
    """For the two-level scheme too, whose native steps are solved by the Schur stepper."""
    model = build_model(build("four_particle"), default_scheme(build("four_particle"), order))
    instance, polynomial = engine(model), polynomial_of(model)
    for k in range(3):
        x = instance.x
        instance.do_step(0.02 * k, 0.02)
        assert np.abs(polynomial(x, instance.unknowns, 1.0) - instance.x).max() < 1e-15
        assert np.array_equal(polynomial(x, instance.unknowns, 0.0), x)


@pytest.mark.slow
def test_adaptive_and_restarted_steps_have_rows_within_them_too():
    from phfmu.components.scenes.electrical.two_machine import two_machine

    scene = two_machine()
    s = stepper(scene.declaration(), Collocated(2), NativeInstance)
    result = run(s, Options(stop=1e-3, step=1e-4, rtol=1e-4, dense=3, events=[Event(5e-4, "fault.G", 20.0)], restart=1))
    assert result.restarted == 1
    assert result.interpolated.sum() == 3 * result.steps
    assert 5e-4 in result.time[~result.interpolated]
    v, t = result.column("load.v[1]"), result.time
    assert np.abs(np.diff(v[t <= 5e-4])).max() < 0.1 * np.abs(v).max()


def test_the_table_marks_interpolated_rows(tmp_path, capsys):
    import pyarrow.parquet as pq

    words = ["run", "oscillator", "--engine", "python", "--stop", "0.05", "--dense", "1", "--quiet"]
    for name in ("o.csv", "o.parquet"):
        assert main([*words, "-o", str(tmp_path / name)]) == 0
    header, *rows = (tmp_path / "o.csv").read_text().splitlines()
    assert header.startswith("time,interpolated,")
    assert [r.split(",")[1] for r in rows] == ["0", *["1", "0"] * (len(rows) // 2)]
    assert pq.read_table(tmp_path / "o.parquet")["interpolated"].to_pylist()[:3] == [False, True, False]
    assert main([*words[:-3], "--dense", "0"]) == 2
    assert "--dense 0" in capsys.readouterr().err
