"""Fits of parameters to measurements: recovered values, their standard errors, what the data cannot tell, the command."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phfmu as ph
from phfmu import NativeInstance, Options, build_model, run
from phfmu.cli import main
from phfmu.components.library import build
from phfmu.derivatives.fits.fit import Experiment, fit
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.results.table import Table
from tests.wide import wide

pytestmark = pytest.mark.usefixtures("compiler")

NOISE, STEP, STOP = 0.02, 1e-3, 0.2
MEASURED = ["terminal.i", "shaft.speed"]


def measured(seed: int, every: int = 1, voltage: float = 12.0) -> Table:
    """The current and speed of the motor at its own parameters, with noise of 2 % of their largest size."""
    model = build_model(build("dc_motor"), ph.Collocated(2))
    stepper = Monolithic(model, NativeInstance(model))
    stepper.set_value("terminal.v", voltage)
    r = run(stepper, Options(stop=STOP, step=STEP))
    columns = np.column_stack([r.column(m) for m in MEASURED])[::every]
    noise = NOISE * np.abs(columns).max(axis=0) * np.random.default_rng(seed).normal(size=columns.shape)
    return Table(MEASURED, r.time[::every], columns + noise, ["A", "rad/s"])


def fitted(data: list[Table], start: dict[str, float], free: list[str], **more: Any) -> Any:
    model = build_model(build("dc_motor").with_starts(start), ph.Collocated(2))
    values = more.pop("values", [{"terminal.v": 12.0}] * len(data))
    options = Options(stop=STOP, step=STEP)
    own = [Experiment(str(i), d, options, v) for i, (d, v) in enumerate(zip(data, values, strict=True))]
    return fit(model, NativeInstance(model), own, free, MEASURED, **more)


@pytest.mark.parametrize("seed", wide(list(range(12)), 0, 1))
def test_values_come_back_within_their_errors(seed: int) -> None:
    """From starts that are 40 % off; the residual is the noise, and nothing is left in it."""
    found = fitted([measured(seed)], {"R": 0.56, "L": 1.2e-3, "k": 0.07}, ["R", "L", "k"])
    for name, true in {"R": 0.4, "L": 2e-3, "k": 0.05}.items():
        assert abs(found.values[name] - true) <= 4.0 * found.errors[name], name
        assert 0 < found.errors[name] < 0.05 * true
    assert found.residual == pytest.approx(NOISE, rel=0.15) and found.misfit == {} and found.undetermined == ()
    assert found.between == 0 and found.iterations <= 25


def test_errors_are_those_of_many_draws() -> None:
    """The scatter of the estimates over draws of the noise is the standard error that one fit tells."""
    draws = [fitted([measured(100 + i, every=4)], {"R": 0.44}, ["R", "k"]) for i in range(24)]
    for name in ("R", "k"):
        scatter = np.std([f.values[name] for f in draws], ddof=1)
        assert scatter == pytest.approx(np.mean([f.errors[name] for f in draws]), rel=0.5)


def test_what_the_data_cannot_tell_is_named() -> None:
    """Inertia and damping times a factor, k times its root: the current alone does not tell the size of the rotor."""
    model = build_model(build("dc_motor"), ph.Collocated(2))
    options, own = Options(stop=STOP, step=STEP), measured(0)
    data = Table(["terminal.i"], own.time, own.values[:, :1], ["A"])
    found = fit(
        model, NativeInstance(model), [Experiment("a", data, options, {"terminal.v": 12.0})], ["J", "k", "d", "R"],
        ["terminal.i"],
    )  # fmt: skip
    (direction,) = found.undetermined
    assert {"J", "k"} <= set(direction) <= {"J", "d", "k"}
    assert found.errors["J"] == np.inf and np.isfinite(found.errors["R"])
    J, k = (direction[n] * x / found.values[n] for n, x in (("J", 1e-4), ("k", 0.05)))
    assert J / k == pytest.approx(2.0, rel=1e-3)


def bounces(noise: float, seed: int = 0) -> Table:
    """A body of `buffer` with another bumper and spring, told on the grid; noise: part of its largest distance."""
    model = build_model(build("buffer").declaration().with_starts({"body.e": 0.62, "spring.k": 230.0}))
    r = run(Monolithic(model, NativeInstance(model)), Options(stop=0.8, step=5e-3))
    rows = np.isclose(np.remainder(r.time / 5e-3 + 0.5, 1.0), 0.5) & np.append(True, np.diff(r.time) > 0)
    q = r.column("body.q")[rows]
    size = noise * np.abs(q).max()
    drawn = q + size * np.random.default_rng(seed).normal(size=len(q))
    return Table(["body.q"], r.time[rows], drawn[:, None], ["m"])


def fitted_bounces(data: Table, **more: Any) -> Any:
    model = build_model(build("buffer").declaration())  # e = 0.5, k = 200 N/m
    own = Experiment("bounces", data, Options(stop=0.8, step=5e-3))
    return fit(model, NativeInstance(model), [own], ["body.e", "spring.k"], ["body.q"], **more)


def test_restitution_and_stiffness_of_a_bouncing_contact() -> None:
    """Impacts that pile up and end at rest: their instants move with both, and their number changes on the way."""
    found = fitted_bounces(bounces(0.0))
    # what was made by the same steps comes back; rest begins at a kink of rounding, 1e-8 of the step after the last impact
    assert found.values["body.e"] == pytest.approx(0.62, rel=1e-8)
    assert found.values["spring.k"] == pytest.approx(230.0, rel=1e-8)
    assert found.sequences > 1 and found.between == 0


@pytest.mark.parametrize("seed", wide(list(range(6)), 0))
def test_a_noisy_contact_comes_back_within_its_errors(seed: int) -> None:
    found = fitted_bounces(bounces(0.02, seed))
    size = float(np.abs(bounces(0.0).column("body.q")).max())
    for name, true in {"body.e": 0.62, "spring.k": 230.0}.items():
        assert abs(found.values[name] - true) <= 4.0 * found.errors[name], name
        assert 0 < found.errors[name] < 0.02 * true
    assert found.residuals["body.q"] == pytest.approx(0.02 * size, rel=0.2)


def test_two_experiments_and_a_start_value() -> None:
    tables = [measured(3), measured(4, voltage=6.0)]
    values = [{"terminal.v": 12.0}, {"terminal.v": 6.0}]
    found = fitted(tables, {"w": 8.0, "R": 0.5}, ["R", "w"], values=values)
    assert abs(found.values["R"] - 0.4) <= 4 * found.errors["R"] and abs(found.values["w"]) <= 4 * found.errors["w"]
    assert {name for name, *_ in found.curves} == {"0", "1"}


def test_a_model_that_misses_something_is_told() -> None:
    """A motor without friction and with half the inductance: residuals follow each other."""
    found = fitted([measured(5)], {"L": 1e-3}, ["R"])
    assert "terminal.i" in found.misfit


def test_bounds_hold_and_are_told() -> None:
    found = fitted([measured(6)], {}, ["R"], bounds={"R": (0.4, 0.41)})
    assert 0.4 <= found.values["R"] <= 0.41
    with pytest.raises(ValueError, match="R begins at 0.4, outside its bounds"):
        fitted([measured(6)], {}, ["R"], bounds={"R": (1.0, 2.0)})


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The file of a fit is taken by --set, and its values make the run that was measured."""
    data, out = measured(7).save(tmp_path / "data.csv"), tmp_path / "fit.json"
    words = ["--set", "terminal.v=12", "--order", "4", "--step", str(STEP)]
    free = ["--free", "L,R", "--measure", "terminal.i", "--set", "R=0.5"]
    for ending in ("html", "png"):
        assert (
            main(["fit", "dc_motor", str(data), *free, *words, "-o", str(out), "--plot", str(tmp_path / f"f.{ending}")])
            == 0
        )
    told = capsys.readouterr().out
    found = json.loads(out.read_text())
    assert {"values", "errors", "residual", "iterations"} <= set(found) and "standard error" in told
    assert found["values"]["R"] == pytest.approx(0.4, rel=0.05) and (tmp_path / "f.png").stat().st_size > 5000
    assert main(["run", "dc_motor", *words, "--set", f"@{out}", "--stop", "0.01", "--quiet"]) == 0
    assert (tmp_path / "f.html").read_text().count('"mode":"markers"') == 2  # measurements, residuals
    assert main(["fit", "dc_motor", str(data), *free, *words[:2], "--set", "L=-1"]) == 2
    assert "refused for its values" in capsys.readouterr().err
    assert main(["run", "dc_motor", *words, "--set", f"@{data}", "--stop", "0.01"]) == 2
    assert "expected a file of phfmu fit" in capsys.readouterr().err
    assert main(["fit", "dc_motor", str(data), "--free", "R", "--measure", "terminal.x", *words]) == 2
    assert "has no signal 'terminal.x'" in capsys.readouterr().err


def test_the_command_takes_more_experiments(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = measured(8).save(tmp_path / "a.csv")
    more = measured(9, voltage=6.0).save(tmp_path / "b.csv")
    words = [
        "--free",
        "R,k",
        "--measure",
        "terminal.i,shaft.speed",
        "--set",
        "terminal.v=12",
        "--set",
        "k=0.06",
        "--order",
        "4",
    ]
    words += ["--experiment", f"{more}:terminal.v=6", "--step", str(STEP), "-o", str(tmp_path / "f.json")]
    assert main(["fit", "dc_motor", str(data), *words]) == 0
    assert "from 804 measurements" in capsys.readouterr().out
    found = json.loads((tmp_path / "f.json").read_text())
    assert found["values"]["k"] == pytest.approx(0.05, rel=5e-3) and found["residual"] == pytest.approx(NOISE, rel=0.3)


class Killed(Exception):
    """The end of a fit."""


def killed(after: int, **more: Any) -> Any:
    """A fit of three tries that ends before its runs are more than these."""

    def progress(runs: int, residual: float) -> None:
        if runs > after:
            raise Killed

    return fitted([measured(11)], {"R": 0.6, "L": 1.4e-3}, ["R", "L", "k"], tries=3, progress=progress, **more)


@pytest.mark.parametrize("after", [1, 6, 14])
def test_a_fit_that_was_killed_goes_on(after: int, tmp_path: Path) -> None:
    """Runs that were taken are not taken again, also where the last one was half written; the result is that of one fit."""
    file = tmp_path / "fit.runs"
    whole = killed(1000)
    with pytest.raises(Killed):
        killed(after, resume=file)
    with open(file, "r+b") as half:
        half.truncate(file.stat().st_size - 100)
    found = killed(1000, resume=file)
    assert found.runs <= whole.runs - after + 3  # rounding of derivatives may add or save a last iteration
    for name, value in whole.values.items():
        assert found.values[name] == pytest.approx(value, rel=1e-7)
        assert found.errors[name] == pytest.approx(whole.errors[name], rel=1e-6)
    again = killed(1000, resume=file)
    assert again.runs == 0 and again.values == found.values and again.errors == found.errors
    assert again.sequences == found.sequences and again.between == found.between


def test_the_file_of_another_fit_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "fit.runs"
    with pytest.raises(Killed):
        killed(1, resume=file)
    with pytest.raises(ValueError, match="is of another fit: other data or weights;"):
        fitted([measured(12)], {"R": 0.6, "L": 1.4e-3}, ["R", "L", "k"], resume=file)
    with pytest.raises(ValueError, match="other free values"):
        fitted([measured(11)], {"R": 0.6, "L": 1.4e-3}, ["R", "L"], resume=file)
    file.write_text("time,terminal.i\n")
    with pytest.raises(ValueError, match="is not the file of a fit"):
        killed(1, resume=file)


def test_the_command_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, runs = measured(7).save(tmp_path / "data.csv"), tmp_path / "fit.runs"
    words = ["fit", "dc_motor", str(data), "--free", "R,L", "--measure", "terminal.i", "--set", "terminal.v=12"]
    words += ["--set", "R=0.5", "--step", str(STEP), "--resume", str(runs)]
    assert main(words) == 0
    first = capsys.readouterr().out
    assert main(words) == 0
    again = capsys.readouterr().out
    assert ", 0 runs" in again and first.splitlines()[1:] == again.splitlines()[1:]
    assert main([w.replace("R=0.5", "R=0.7") for w in words]) == 2
    assert "is of another fit: other model" in capsys.readouterr().err
