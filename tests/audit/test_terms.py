"""Energies and resistors told by themselves: what each stores and loses, their sums, and that nobody else pays for it."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import phfmu as ph
from phfmu import PHDAE, Collocated, NativeInstance, Options, PythonInstance, Scene, block, build_model, energy, skew
from phfmu.audit import read, summarise
from phfmu.cli import main
from phfmu.components.library import build
from phfmu.components.mechanical.translational import mass
from phfmu.discretise.accounts import by_term
from phfmu.engine.switched import stepped
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.runs.loop import run
from phfmu.runs.result import Result
from tests.wide import wide

ENGINES = {"python": PythonInstance, "native": NativeInstance}
SCENES = ("drive", "smib", "smib_breaker", "rectifier", "buffer", "bouncing_ball", "clutch_engagement", "four_particle")


def ran(declaration: PHDAE, engine: str, options: Options, order: int = 2) -> Result:
    model = build_model(declaration, Collocated(order // 2) if order != 2 else None)
    return run(Monolithic(model, stepped(model, ENGINES[engine])), options)


def sums(result: Result) -> dict[str, float]:
    return {f"{t.component}.{t.term}": t.energy for t in result.ledger.summary().terms}


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("engine", ENGINES)
def test_a_mass_on_a_spring_tells_what_each_part_has(engine: str, order: int, request: pytest.FixtureRequest) -> None:
    """Against the solution: x'' = -k/m x - d/m x'; energies of spring and mass at the end, and the loss of the damper."""
    if engine == "native":
        request.getfixturevalue("compiler")
    m, k, d, q, t = 2.0, 50.0, 0.6, 0.1, 1.5
    s, w = d / (2 * m), np.sqrt(k / m - (d / (2 * m)) ** 2)
    x = q * np.exp(-s * t) * (np.cos(w * t) + s / w * np.sin(w * t))
    v = -q * np.exp(-s * t) * k / (m * w) * np.sin(w * t)
    exact = {"mass.H(q)": k / 2 * (x**2 - q**2), "mass.H(v)": m / 2 * v**2}
    exact["mass.R(d)"] = -sum(exact.values())
    found = sums(ran(by_term(mass(m, k=k, d=d, q=q)), engine, Options(stop=t, step=5e-4), order))
    assert found == pytest.approx(exact, rel=1e-5 if order == 2 else 1e-9)


@pytest.mark.parametrize("name", wide(SCENES, "drive", "four_particle"))
def test_terms_add_up_to_their_component_and_change_nothing(name: str, compiler: None) -> None:
    found = build(name)
    d = found.declaration() if isinstance(found, Scene) else found
    step = found.step if isinstance(found, Scene) else 0.01
    options = Options(stop=200 * step, step=step)
    plain, detailed = (ran(declared, "native", options) for declared in (d, by_term(d)))
    assert plain.ledger.summary().terms == []
    assert detailed.names == plain.names
    size = np.abs(plain.values).max(axis=0, initial=1e-3)
    assert np.abs(detailed.values - plain.values).max() <= 1e-7 * size.max()
    summary = detailed.ledger.summary()
    assert summary.closed and len(summary.terms) >= len(summary.components) - 1
    for c in summary.components:
        own = [t for t in summary.terms if t.component == c.component]
        flow = abs(c.stored) + abs(c.dissipated) + abs(c.supplied) + sum(abs(t.energy) for t in own)
        assert abs(sum(t.energy for t in own if t.stores) - c.stored) <= 1e-12 * flow
        assert abs(sum(t.energy for t in own if not t.stores) - c.dissipated) <= 1e-12 * flow


def test_names_are_those_of_states_and_parameters() -> None:
    """Parts of one name are one; a part without parameters is called by its variables."""
    x, y = ph.state("x", 3), ph.state("y")
    r, s = ph.parameter("r", 2.0), ph.parameter("s", [1.0, 4.0], 2)
    R = block([x, y], ca.diag(ca.vertcat(r.sx, r.sx, s[1], 3.0)))
    energies = energy(ca.sumsqr(x.sx) / 2), energy(y.sx**2 / 2)
    d = PHDAE("parts", states=(x, y), parameters=(r, s), energies=energies, dissipation=(R,))
    assert by_term(d).members == ("", ":H(x[1..3])", ":H(y)", ":R(r)", ":R(s[2])", ":R(y)")
    assert len(by_term(d).dissipation) == 3


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("terms") / "x.parquet"
    assert main(["run", "drive", "--audit-detail", "--audit", str(path), "--stop", "0.05", "--quiet"]) == 0
    return path


def test_the_log_of_a_run_has_its_terms(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    live = ran(by_term(build("drive").declaration()), "native", Options(stop=0.05, step=build("drive").step))
    there = {f"{t.component}.{t.term}": t.energy for t in summarise(log).terms}
    assert there == pytest.approx(sums(live), rel=1e-9)
    assert main(["audit", str(log), "--by", "term", "--percent"]) == 0
    text = capsys.readouterr().out
    assert "motor.R(R)" in text and "shaft.H(twist)" in text and "percent of" in text and "terminal" not in text
    assert main(["audit", str(log), "--by", "term", "--export", "csv", "--window", ":0.02"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "term,stored [J],dissipated [J]" and len(lines) == 1 + len(there)


def test_a_log_without_terms_says_how_to_have_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.parquet"
    assert main(["run", "drive", "--audit", str(path), "--stop", "0.01", "--quiet"]) == 0
    assert "term" not in read(path).column_names
    assert main(["audit", str(path), "--by", "term"]) == 0
    assert "there is no term in it" in (text := capsys.readouterr().out) and "--audit-detail" in text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--coupling", "newton"], "take --coupling monolithic"),
        (["--engine", "fmu"], "take --engine native or python"),
        (["--gradient", "joint-gonzalez"], "a joint gradient makes one term of all energies"),
    ],
)
def test_what_cannot_tell_terms_apart_is_refused(
    options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "drive", "--audit-detail", *options]) == 2
    assert words in capsys.readouterr().err


def test_a_joined_loss_is_one_part() -> None:
    """A damper between two states is one term, whatever else the block holds."""
    a, b, c = (ph.state(n) for n in "abc")
    d = ph.parameter("d", 1.0)
    R = block([a, b, c], ca.vertcat(ca.horzcat(d.sx, -d.sx, 0), ca.horzcat(-d.sx, d.sx, 0), ca.horzcat(0, 0, 2)))
    H = energy((a.sx**2 + b.sx**2 + c.sx**2) / 2)
    found = by_term(
        PHDAE(
            "joined", states=(a, b, c), parameters=(d,), energies=(H,), structure=(skew(a, c, 1.0),), dissipation=(R,)
        )
    )
    assert found.members[-2:] == (":R(d)", ":R(c)")
