"""When Newton's method stops: at rounding, not at slow progress, and with the floor named when it fails."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import phfmu.engine
from phfmu import PHDAE, NativeInstance, PythonInstance, Status, StepFailure, TwoLevel, build_model
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.engine.reference import newton
from phfmu.outcome.limits import LIMITS
from phfmu.schemes.named import named_scheme
from phfmu.studies.stress.mechanisms import doubled
from tests.engines import ENGINES

ENGINE = Path(phfmu.engine.__path__[0])


def four(**starts):
    d = four_particle().with_starts({k.replace("_", "[") + "]" if "_" in k else k: v for k, v in starts.items()})
    return build_model(d, named_scheme(d, "semi-explicit", 2, "per-term"))


@pytest.mark.parametrize("engine", ENGINES)
def test_slow_progress_is_not_taken_for_rounding(engine):
    """117 rad a step: the constraint is nearly singular and Newton shrinks by half; every step must still balance.

    Steps are cut into up to 16 parts; taking slow progress for rounding would leave 6e-8 of H.
    """
    instance = engine(four(v_12=1.18e4))
    for k in range(4 if engine is NativeInstance else 3):
        instance.do_step(0.01 * k, 0.01)
        row = instance.ledger()
        H = instance.signals()["H"][0]
        assert abs(row["stored"][0] + row["dissipated"][0] - row["supplied"][0]) <= 1e-12 * H


@pytest.mark.parametrize("engine", ENGINES)
def test_an_old_matrix_that_leads_astray_is_given_up(engine):
    """The first step of a particle of 1e-12 kg between stiff springs needs no halving."""
    instance = engine(four(m_4=1e-12, eta0=0.0))
    instance.do_step(0.0, 0.01)
    assert instance.counts["substeps"] == 0 and instance.counts["line_searches"] == 0


def test_both_engines_name_the_same_floor():
    """At 2e6 m/s Newton finds no solution; the error says how far rounding would go.

    The smallest substep is tried before the iterations run out, so that both engines end in the same attempt.
    """
    found = []
    for engine in ENGINES:
        with pytest.raises(StepFailure, match="rounding floor") as failure:
            engine(four(v_12=2e6)).do_step(0.0, 0.01)
        found.append(failure.value)
    one, two = found
    assert not one.ran_out and not two.ran_out
    assert one.status is two.status is Status.NO_CONVERGENCE and one.equation == two.equation
    assert one.iterations == two.iterations
    assert one.floor == pytest.approx(two.floor, rel=1e-6) and 0 < one.floor < 1e-12
    assert one.update == pytest.approx(two.update, rel=1e-2)
    assert np.isfinite(one.residual) and one.residual > 1e3 * one.floor


def test_no_constant_of_the_solvers_stands_twice() -> None:
    """A number that both engines go by is defined in step_limits.h; neither a Python file nor its C twin has it too."""
    number = r"(\w+) (?:= )?[(]?\d"
    twins = [p for p in (ENGINE / "reference").glob("*.py") if (ENGINE / "runtime" / f"{p.stem}.c").exists()]
    assert {p.stem for p in twins} >= {"newton", "attempts", "rest", "rest_start"}
    python = {
        (p.name, n)
        for p in [*twins, ENGINE / "reference" / "solves.py"]
        for n in re.findall(f"^{number}", p.read_text(), re.M)
    }
    sources = [*(ENGINE / "runtime").glob("*.[ch]")]
    c = {n.removeprefix("PH_") for p in sources for n in re.findall(f"^#define {number}", p.read_text(), re.M)}
    assert {"TOLERANCE", "STAGNATION", "DEPTH", "CHORD"} <= c
    whole = {p: re.findall(r"^#define (\w+)", p.read_text(), re.M) for p in (ENGINE / "runtime").rglob("*.*")}
    shared = set(whole.pop(ENGINE / "runtime" / "step_limits.h"))
    assert {n for names in whole.values() for n in names} & shared == set()
    assert {(name, n) for name, n in python if n in c or n in LIMITS} == set()


@pytest.mark.parametrize("declaration", [four_particle(), doubled()], ids=["four particles", "redundant bars"])
def test_full_and_sparse_factors_lead_to_the_same_steps(declaration: PHDAE, monkeypatch: pytest.MonkeyPatch) -> None:
    """By LAPACK and by SuperLU, also where columns depend on each other."""
    model, found = build_model(declaration, TwoLevel(1)), []
    assert 0 < model.step.nw <= newton.FULL
    for limit in (newton.FULL, 0):
        monkeypatch.setattr(newton, "FULL", limit)
        instance = PythonInstance(model)
        found.append((instance.run(0.0, 0.01, 10, ("x",))["x"], instance.counts))
    assert np.abs(found[0][0] - found[1][0]).max() <= 1e-13
    assert found[0][1] == found[1][1]


@pytest.mark.slow
def test_an_update_that_sums_of_large_states_swallow_ends_the_iteration(compiler: None, tmp_path: Path) -> None:
    """A shunt of 5 A where lines bring 1e5 A: its update stays 1.5e-11 A, of a value that grows by as much each time."""
    from phfmu.cli import main

    data = Path(phfmu.__path__[0]) / "components" / "grids" / "data" / "ieee39"
    line = [
        "run",
        str(data / "ieee39.raw"),
        "--dynamics",
        str(data / "*.csv"),
        "--fault",
        "bus16:0.02:0.04",
        "--stop",
        "0.03",
    ]
    assert main([*line, "-o", str(tmp_path / "run.csv"), "--quiet"]) == 0
