"""How accurate a run is, told by the run in finer steps: estimates against exact errors, events, inputs, couplings, units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phfmu import Collocated, Monolithic, Options, PythonInstance, build_model, run
from phfmu.cli import main
from phfmu.components.library import build
from phfmu.components.mechanical.translational import mass
from phfmu.runs.accuracy import RepeatRecord, RunRecord, accuracy

M, K = 2.0, 50.0


def rows(record, k, h, room=None):
    """A run of a mass on a spring: q = cos(5 t)."""
    model = build_model(mass(M, k=K, q=1.0), Collocated(k))
    options = Options(stop=2.0, step=h, columns=record.columns, keep=record.keep, happened=record.event, audited=False)
    run(Monolithic(model, PythonInstance(model)), options)
    return record


def compared(k, h, room=4_000_000):
    record = rows(RunRecord(h, room), k, h)
    finer, coarser = (rows(RepeatRecord(record, h), k, f * h) for f in (0.5, 2.0))
    return record, accuracy(record, finer, coarser, 2.0 ** (2 * k), 2 * k)


@pytest.mark.parametrize(("k", "h"), [(1, 0.01), (2, 0.04), (3, 0.1)])
def test_the_error_told_is_the_error(k, h):
    """Of q = cos(5 t) and of the force of the spring, within 3 %, in size and place; the order is observed."""
    record, found = compared(k, h)
    time, values, _ = record.table()
    change = next(c for c in found.changes if c.name == "q")
    error = np.abs(values[:, record.names.index("q")] - np.cos(5 * time))
    assert change.error == pytest.approx(error.max(), rel=0.03)
    assert change.order == pytest.approx(2 * k, abs=0.1)
    assert abs(change.time - time[error.argmax()]) <= 2 * h
    assert change.scale == pytest.approx(2.0, rel=0.02)
    assert found.observed == pytest.approx(2 * k, abs=0.1)


def test_means_are_compared_with_those_of_both_halves():
    """The mean velocity of a step against its exact value, (q(t) - q(t - h)) / h."""
    h = 0.02
    record, found = compared(1, h)
    time, values, _ = record.table()
    (name,) = [n for n in record.names if n.endswith("velocity_step")]
    exact = (np.cos(5 * time[1:]) - np.cos(5 * (time[1:] - h))) / h
    error = np.abs(values[1:, record.names.index(name)] - exact).max()
    change = next(c for c in found.changes if c.name == name)
    assert change.order is None and change.error == pytest.approx(error, rel=0.05)


def test_long_runs_are_thinned_and_tell_nearly_the_same():
    whole, all_rows = compared(1, 0.005)
    thin, some_rows = compared(1, 0.005, room=len(whole.names) * 50)
    assert len(whole.table()[0]) == 401 and 25 <= len(thin.table()[0]) <= 51
    for a in all_rows.changes:
        (b,) = [c for c in some_rows.changes if c.name == a.name]
        assert a.scale == b.scale and b.size <= a.size * (1 + 1e-12)
        assert b.size > 0.8 * a.size or a.relative < 1e-8


def test_a_signal_that_does_not_come_closer_has_no_error():
    """One that changes more from 0.1 s to 0.05 s than from 0.2 s to 0.1 s."""

    def given(to, step, value):
        time = step * np.arange(round(1.0 / step) + 1)
        to.columns(["a", "b"], ["V", "V"], ["state", "state"])
        to.keep(time, np.stack([value * time, 7.0 + time], axis=1), np.zeros(len(time), bool))
        return to

    record = given(RunRecord(0.1), 0.1, 1.0)
    finer, coarser = given(RepeatRecord(record, 0.1), 0.05, 0.0), given(RepeatRecord(record, 0.1), 0.2, 0.5)
    a, b = accuracy(record, finer, coarser, 4.0, 2).changes
    assert (a.name, a.error, a.size, a.time) == ("a", None, 1.0, 1.0) and a.order == pytest.approx(-1.0)
    assert (b.size, b.error) == (0.0, 0.0)


def lines(capsys, *words):
    code = main(["run", *words, "--accuracy"])
    out, err = capsys.readouterr()
    return code, out[out.find("accuracy:") :].splitlines() if "accuracy:" in out else [], err


def told(text, name):
    """Change, time, part of the range, order, error of a signal in the table."""
    (line,) = [row for row in text if row.split()[:1] == [name]]
    return line.split()[1:]


@pytest.mark.parametrize(
    "words",
    [
        ("oscillator", "--coupling", "newton", "--order", "4", "--signals", "*.q"),
        ("oscillator", "--engine", "fmu", "--signals", "*.q"),
        ("oscillator", "--coupling", "gauss-seidel", "--signals", "*.q", "--every", "5"),
    ],
    ids=["newton", "fmu", "gauss-seidel"],
)
def test_couplings_and_units_of_our_own(words, capsys):
    code, text, _ = lines(capsys, *words, "--stop", "0.5", "--step", "0.005")
    assert code == 0
    order = {"4": 4.0}.get(words[4] if len(words) > 4 else "", 1.0 if "gauss-seidel" in words else 2.0)
    change, _, part, seen, error, _, unit = told(text, "mass1.q")
    assert unit == "m" and 0 < float(part) < 0.1 and float(error) > float(change)
    if order > 1:
        assert float(seen) == pytest.approx(order, abs=0.15)
    assert any(line.startswith(f"order {order:g} declared") for line in text)


def test_state_events_and_their_times(capsys):
    code, text, _ = lines(capsys, "rectifier", "--order", "4", "--signals", "load.flux")
    assert code == 0
    assert float(told(text, "load.flux")[3]) == pytest.approx(4.0, abs=0.3)
    (line,) = [row for row in text if "state events in both runs" in row]
    assert line.startswith("11 state events") and float(line.split()[-4]) < 1e-8


def test_input_data(tmp_path: Path, capsys):
    t = np.arange(0, 0.51, 0.05)
    table = tmp_path / "u.csv"
    table.write_text("time,flange.force\n" + "".join(f"{x:.3g},{np.sin(9 * x):.17g}\n" for x in t))
    file = tmp_path / "m.py"
    file.write_text(
        "from phfmu import Scene\nfrom phfmu.components.mechanical.translational import mass\n"
        "def m(): return Scene('m', mass(2.0, k=50.0, q=1.0), stop=0.5, step=0.005)\n"
    )
    for way, order in (("held", 2.0), ("cubic", 2.0)):
        code, text, _ = lines(capsys, f"{file}:m", "--input", str(table), "--interpolate", way, "--signals", "q")
        assert code == 0 and float(told(text, "q")[3]) == pytest.approx(order, abs=0.1)


def test_a_unit_is_compared_by_its_communication_step(tmp_path: Path, capsys):
    assert main(["export", "oscillator", "-o", str(tmp_path)]) == 0
    unit = tmp_path / "oscillator_fmi3.fmu"
    code, text, _ = lines(capsys, str(unit), "--stop", "0.5", "--step", "0.01", "--signals", "*.q")
    assert code == 0 and any("no order of units is known" in row for row in text)
    assert float(told(text, "mass1.q")[-3]) == pytest.approx(2 * float(told(text, "mass1.q")[0]), rel=1e-3)


def test_adaptive_steps_are_compared_where_all_land(capsys):
    code, text, _ = lines(
        capsys, "drive", "--rtol", "1e-5", "--order", "4", "--step", "0.02", "--signals", "motor.w", "--stop", "0.5"
    )
    assert code == 0 and "rtol 1e-06" in text[0]
    assert float(told(text, "motor.w")[2]) < 1e-3


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("drive", "--rtol", "1e-5"), "with --rtol give --step too"),
        (("oscillator", "--coupling", "jacobi", "--ecco", "1e-3"), "steps by --ecco have others"),
    ],
)
def test_what_has_no_equal_times_is_refused_by_name(words, says, capsys):
    code, text, err = lines(capsys, *words)
    assert code == 2 and not text and says in err


def test_steps_that_are_too_long_twice_leave_the_declared_order(capsys):
    """four_particle does not solve at twice this step; its changes are told all the same."""
    scene = build("oscillator")
    code, text, _ = lines(capsys, "oscillator", "--stop", str(scene.step), "--signals", "mass1.q")
    assert code == 0 and told(text, "mass1.q")


def test_the_run_and_its_files_are_those_of_a_run_without(tmp_path: Path, capsys):
    files = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for file, more in zip(files, ([], ["--accuracy"]), strict=True):
        assert main(["run", "oscillator", "--stop", "0.1", "-o", str(file), *more]) == 0
    assert files[0].read_bytes() == files[1].read_bytes()
    capsys.readouterr()
