"""Models that grow with n: they are right, and what must not grow does not."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from phfmu import NativeInstance, build_model
from phfmu.cli import FINE, USAGE, main
from phfmu.components.mechanical.net import net
from phfmu.components.scenes.electrical.ladder import ladder
from phfmu.engine.build.codegen import kernel_table
from phfmu.engine.model import kernels
from phfmu.studies.bench.families import FAMILIES
from phfmu.studies.bench.scaling import Size, exponent
from tests.wide import wide


def test_net_swings_and_keeps_its_energy(compiler: None) -> None:
    """Without dampers H is constant; the free edge falls, the accelerations at the start are those of gravity and springs."""
    d = net(3, k=200.0, mass=0.2, spacing=0.5, tension=1.1)
    instance = NativeInstance(build_model(d))
    H0 = instance.signal("H")[0]
    r = instance.run(0.0, 1e-3, 500, record=("energy", "x"))
    assert np.abs(r["energy"][:, 0] - H0).max() <= 1e-12 * max(1.0, abs(H0))
    first = r["x"][0]
    # corner (3, 3) has two springs along the axes: k (s - l)/m each, and gravity
    pull = 200.0 * (0.5 - 0.5 / 1.1) / 0.2
    v = first[27:].reshape(9, 3)[8]
    assert v / 1e-3 == pytest.approx([-pull, -pull, -9.81], rel=1e-3)


def test_ladder_starts_in_steady_state(compiler: None) -> None:
    """Before the torque step speeds and voltages keep their values, the lines carry nothing, up to (w h)^2."""
    scene = ladder(2)
    d = scene.declaration()
    model = build_model(d)
    instance = NativeInstance(model)
    names = [n for v in d.states for n in v.names()]
    x0 = instance.x
    instance.run(0.0, 1e-5, 500)
    x = instance.x
    for i in (1, 2):
        p = names.index(f"gen{i}.p")
        assert x[p] == pytest.approx(x0[p], rel=1e-9)
        charge = [names.index(f"load{i}.charge[{j}]") for j in (1, 2, 3)]
        assert np.linalg.norm(x[charge]) == pytest.approx(np.linalg.norm(x0[charge]), rel=(377 * 1e-5) ** 2)
        flux = [names.index(f"line{i}.flux[{j}]") for j in (1, 2, 3)]
        rated = np.linalg.norm(x0[[names.index(f"gen{i}.psi[{j}]") for j in (1, 2)]])
        assert np.abs(x[flux]).max() <= 1e-6 * rated


@pytest.mark.parametrize(("build", "message"), [(net, "at least 2"), (ladder, "at least one")])
def test_sizes_that_are_none(build, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build(0)


@pytest.mark.slow
@pytest.mark.parametrize("name", wide(FAMILIES, "chain"))
def test_code_is_the_same_and_memory_linear(name: str, compiler: None) -> None:
    """Generated C does not grow (the hooks of the net are numbers in it); unknowns and memory are affine in n."""
    sizes = {"chain": (16, 32, 48), "net": (3, 4, 5), "ladder": (10, 14, 18)}[name]
    models = [build_model(FAMILIES[name].build(n)) for n in sizes]
    texts = [kernel_table(kernels(m)).text for m in models]
    if name == "net":  # a sheet: its factor grows faster than the number of particles
        assert len(texts[2]) == pytest.approx(len(texts[1]), abs=100)
        return
    assert texts[0] == texts[1] == texts[2]
    unknowns = [m.step.nw for m in models]
    assert unknowns[2] - unknowns[1] == unknowns[1] - unknowns[0]
    memory = [NativeInstance(m).memory_size for m in models]
    assert memory[2] - memory[1] == pytest.approx(memory[1] - memory[0], rel=0.05)


def test_planned_pivots_are_distinct() -> None:
    """Also where two columns want one row (the bare bus of the grid): a trial factor with them stays sparse."""
    from phfmu.engine.build.derived import factor_values

    plans = [build_model(ladder(n).declaration()).step for n in (4, 12)]
    for p in plans:
        assert np.array_equal(np.sort(p.pivot_row), np.arange(p.nw))
    room = [factor_values(p)["lucap"] / p.nw for p in plans]
    assert room[1] == pytest.approx(room[0], rel=0.25)


def test_exponent_is_that_of_the_larger_half() -> None:
    sizes = [Size("a", n, 0, 0.0, 0.0, 0, 0.0, 0, 0, n**1.5 + (1e3 if n < 10 else 0), 0.0) for n in (1, 4, 16, 64)]
    assert exponent(sizes, "step") == pytest.approx(1.5)
    assert np.isnan(exponent(sizes[:1], "step"))


@pytest.mark.slow
def test_bench_scaling(compiler: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "scaling", "--families", "chain", "--sizes", "30,60", "-o", str(tmp_path)]) == FINE
    out = capsys.readouterr().out
    assert "chain: n = links" in out and "~ n^" in out
    rows = list(csv.DictReader(t for t in (tmp_path / "scaling.csv").read_text().splitlines() if not t.startswith("#")))
    assert [r["n"] for r in rows] == ["30", "60"] and rows[0]["code"] == rows[1]["code"]
    assert all(float(r[c]) > 0 for r in rows for c in ("declare", "plan", "compile", "memory", "step", "iterations"))
    assert (tmp_path / "scaling.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "said"), [(["--families", "tree"], "chain, net, ladder"), (["--sizes", "2.5"], "whole numbers")]
)
def test_bad_usage(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "scaling", *words]) == USAGE
    assert said in capsys.readouterr().err
