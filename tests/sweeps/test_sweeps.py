"""Many runs: the same numbers as each run by itself, whatever the engine, the threads and what happened in between."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import phfmu as ph
from phfmu import PHDAE, Design, Event, NativeInstance, Options, Scene, build_model, grid, sweep
from phfmu.cli import main
from phfmu.components.library import build
from phfmu.components.mechanical.translational import mass
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.runs.loop import run
from phfmu.runs.result import Result
from phfmu.sweeps.design import axes, table
from phfmu.sweeps.outcome import RunOutcomes
from phfmu.sweeps.runs import taken
from phfmu.sweeps.words import KINDS
from phfmu.sweeps.worker_pool import Threads
from tests.wide import wide

FOUR = grid({"k13": [40.0, 60.0], "m[1]": [1.0, 4.0]})


def alone(scene: Scene, values: dict[str, float], **options: float) -> Result:
    """One run by the run loop, of a declaration with these starts."""
    model = build_model(scene.declaration().with_starts(values))
    o = Options(stop=scene.stop, step=scene.step, events=scene.events, **options)
    return run(Monolithic(model, NativeInstance(model)), o)


def four(stop: float = 0.5) -> Scene:
    return Scene("four", build("four_particle"), stop, 0.01)


def pushed() -> Scene:
    """A mass of m under 2 N on [0.31, 0.52): v = 0.42 / m from then on."""
    return Scene("pushed", mass(2.0), 1.0, 0.1, (Event(0.31, "flange.force", 2.0), Event(0.52, "flange.force", 0.0)))


def test_every_measure_is_that_of_the_run_by_itself(compiler: None) -> None:
    signals = ("v[1]", "q[2]", "energy.stored", "lambda[1]")
    found = sweep(four(), FOUR, [f"{kind}({s})" for kind in KINDS for s in signals])
    for i, row in enumerate(FOUR.rows):
        result = alone(four(), dict(zip(FOUR.names, row, strict=True)))
        for s in signals:
            t, v = result.time, result.column(s)
            area = np.sum(np.diff(t) * (v[1:] + v[:-1]) / 2), np.sum(np.diff(t) * (v[1:] ** 2 + v[:-1] ** 2) / 2)
            exact = {
                "first": v[0], "last": v[-1], "min": v.min(), "max": v.max(), "peak": np.abs(v).max(),
                "tmin": t[v.argmin()], "tmax": t[v.argmax()],
            }  # fmt: skip
            told = {k: found[f"{k}({s})"][i].as_py() for k in exact}
            if s == "energy.stored":  # summed from the changes in the ledger, compensated: to rounding, without a solve
                assert told == pytest.approx(exact, rel=1e-14)
            else:
                assert told == exact
            assert found[f"mean({s})"][i].as_py() == pytest.approx(area[0] / t[-1], rel=1e-13, abs=1e-16)
            assert found[f"rms({s})"][i].as_py() == pytest.approx(np.sqrt(area[1] / t[-1]), rel=1e-13)
    assert set(found["steps"].to_pylist()) == {50} and set(found["error"].to_pylist()) == {""}
    assert max(found["ledger"].to_pylist()) <= 1.0


def test_both_engines_tell_the_same(compiler: None) -> None:
    texts = [f"{kind}(v[1])" for kind in KINDS] + ["last(energy.stored)"]
    native, python = (sweep(four(0.2), FOUR, texts, engine=e) for e in ("native", "python"))
    assert native.column_names == python.column_names
    for name in native.column_names[:-2]:
        assert np.asarray(native[name]) == pytest.approx(np.asarray(python[name]), rel=1e-11, abs=1e-13), name


def test_stored_energy_jumps_with_a_parameter(compiler: None) -> None:
    """A stiffness that is doubled within the run doubles what its spring holds: 1/2 k q^2, told by both engines."""
    scene = Scene("stiffer", mass(2.0, k=8.0, q=0.5), 0.4, 0.1, (Event(0.2, "k", 16.0),))
    wanted, starts = ["first(energy.stored)", "last(energy.stored)", "last(q)", "last(v)"], grid({"q": [0.5, 1.0]})
    found = sweep(scene, starts, wanted).to_pandas()
    assert found["first(energy.stored)"].tolist() == [1.0, 4.0]
    assert found["last(energy.stored)"].to_numpy() == pytest.approx(
        8.0 * found["last(q)"].to_numpy() ** 2 + found["last(v)"].to_numpy() ** 2, rel=1e-14
    )
    assert found["last(energy.stored)"][0] > 1.1  # more than at the start


@pytest.mark.parametrize("engine", ["native", "python"])
def test_events_count_and_the_momentum_is_that_of_the_push(engine: str, compiler: None) -> None:
    found = sweep(pushed(), grid({"m": [1.0, 2.0, 5.0]}), ["last(v)", "tmax(v)"], engine=engine)
    assert np.asarray(found["last(v)"]) == pytest.approx(0.42 / np.array([1.0, 2.0, 5.0]), rel=1e-12)
    assert found["tmax(v)"].to_pylist() == pytest.approx([0.52] * 3, abs=0.1)


def test_a_start_of_a_state_and_an_input_may_vary(compiler: None) -> None:
    runs = Design(("v", "flange.force"), np.array([[1.0, 0.0], [0.0, 3.0], [2.0, -1.0]]))
    found = sweep(mass(2.0), runs, ["last(v)", "first(v)"], options=Options(stop=2.0, step=0.1))
    assert np.asarray(found["last(v)"]) == pytest.approx([1.0, 3.0, 1.0], abs=1e-13)
    assert found["first(v)"].to_pylist() == [1.0, 0.0, 2.0]


@pytest.mark.slow
def test_adaptive_runs_are_those_of_the_run_loop(compiler: None) -> None:
    found = sweep(four(), grid({"k13": [40.0, 60.0]}), ["last(v[1])"], options=Options(stop=0.5, step=0.01, rtol=1e-5))
    for i, k in enumerate((40.0, 60.0)):
        assert found["last(v[1])"][i].as_py() == alone(four(), {"k13": k}, rtol=1e-5).column("v[1]")[-1]


def test_the_number_of_threads_changes_no_bit(compiler: None) -> None:
    runs = grid({"k13": np.linspace(40, 60, 97)})
    found = [sweep(four(), runs, ["last(v[1])", "mean(energy.stored)"], jobs=jobs) for jobs in (1, 2, 5)]
    assert found[0].equals(found[1]) and found[0].equals(found[2])


@pytest.mark.slow
def test_a_run_does_not_depend_on_the_one_before_it(compiler: None) -> None:
    rows = grid({"k13": np.linspace(40, 60, 7)}).rows
    ways = [
        sweep(four(), Design(("k13",), r), ["last(v[1])"], jobs=1)["last(v[1])"].to_pylist() for r in (rows, rows[::-1])
    ]
    assert ways[0] == ways[1][::-1]


@pytest.mark.filterwarnings("ignore:invalid value")  # numpy's word for the energy that is not finite
@pytest.mark.parametrize("engine", wide(["native", "python"], "native"))
def test_runs_that_fail_are_rows_with_their_reason(engine: str, compiler: None) -> None:
    """A start off the constraints, and an energy that is not finite; the others go on."""
    q = build("four_particle").states[0].start[0]
    runs = Design(("q[1]", "k13"), np.array([[q, 50.0], [q + 0.1, 50.0], [q, 1e308], [q, 60.0]]))
    found = sweep(four(), runs, ["last(v[1])"], engine=engine, jobs=1)
    errors = found["error"].to_pylist()
    assert errors[0] == errors[3] == "" and "inconsistent start" in errors[1] and errors[2]
    assert [v is None for v in found["last(v[1])"].to_pylist()] == [False, True, True, False]
    fine = sweep(four(), Design(runs.names, runs.rows[[0, 3]]), ["last(v[1])"], engine=engine)
    assert found["last(v[1])"].to_pylist()[::3] == fine["last(v[1])"].to_pylist()


@pytest.mark.parametrize("engine", ["native", "python"])
def test_a_ledger_that_does_not_close_is_told_run_by_run(engine: str, compiler: None) -> None:
    """q' = p, p' = (gain - k) q beside a reservoir of 1e6 J: what is not skew in J makes energy out of nothing."""
    q, p, store = ph.state("q", start=1.0), ph.state("p"), ph.state("store", start=np.sqrt(2e6))
    k, gain = ph.parameter("k", 4.0), ph.parameter("gain", 0.0)
    made = PHDAE(
        "oscillator",
        states=(q, p, store),
        parameters=(k, gain),
        energies=(ph.energy(0.5 * k.sx * q.sx**2), ph.energy(0.5 * p.sx**2), ph.energy(0.5 * store.sx**2)),
        structure=(ph.block((q, p), ca.blockcat([[0.0, 1.0], [gain.sx - 1.0, 0.0]])),),
    )
    runs = grid({"gain": [0.0, 1e-3, 0.0]})
    ledger = np.asarray(sweep(made, runs, ["last(q)"], options=Options(stop=1.0, step=0.01), engine=engine)["ledger"])
    assert ledger[0] == ledger[2] <= 1.0 and ledger[1] > 1e3


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("k=1:3:5", [1, 1.5, 2, 2.5, 3]),
        ("k=log:1:100:3", [1, 10, 100]),
        ("k=log:-1:-100:3", [-1, -10, -100]),
        ("k=4,2,7.5", [4, 2, 7.5]),
        ("k=3", [3]),
    ],
)
def test_axes(text: str, values: list[float]) -> None:
    assert axes([text]).rows[:, 0] == pytest.approx(values, rel=1e-15)


def test_axes_are_combined_the_last_one_fastest() -> None:
    assert axes(["a=1,2", "b=5,6,7"]).rows.tolist() == [[a, b] for a in (1, 2) for b in (5, 6, 7)]


@pytest.mark.parametrize(
    ("items", "words"),
    [
        (["k"], "expected NAME=FROM:TO:COUNT"),
        (["k=1:2"], "expected"),
        (["k=1:2:0"], "count from 1"),
        (["k=log:-1:1:3"], "two ends of one sign"),
        (["k=a,b"], "expected"),
        (["k=1:2:3:4"], "expected"),
        (["k=nan"], "finite"),
        (["k=1", "k=2"], "given twice"),
        (["m=1", "m[1]=2"], "vary the same number"),
    ],
)
def test_axes_that_are_none(items: list[str], words: str) -> None:
    with pytest.raises(ValueError, match=words.replace("[", r"\[")):
        axes(items)


def test_a_table_gives_the_runs(tmp_path: Path) -> None:
    (tmp_path / "runs.csv").write_text("k13,m[1]\n40,1\n50,2.5\n")
    found = table(str(tmp_path / "runs.csv"))
    assert found.names == ("k13", "m[1]") and found.rows.tolist() == [[40, 1], [50, 2.5]]
    pq.write_table(pa.table({"k13": ["a"]}), tmp_path / "runs.parquet")
    with pytest.raises(ValueError, match="expected numbers"):
        table(str(tmp_path / "runs.parquet"))


@pytest.mark.parametrize(
    ("names", "measure", "error", "words"),
    [
        (("k31",), "max(v[1])", KeyError, "did you mean k13"),
        (("k13",), "max(w[1])", ValueError, "no signal"),
        (("k13",), "maxi(v[1])", ValueError, "did you mean max"),
        (("k13",), "v[1]", ValueError, "expected KIND"),
    ],
)
def test_what_does_not_exist_is_named(names: tuple[str], measure: str, error: type, words: str) -> None:
    with pytest.raises(error, match=words):
        sweep(four(), Design(names, np.ones((1, 1))), [measure])


def test_what_the_scene_sets_at_its_start_does_not_vary() -> None:
    scene = replace(pushed(), events=(Event(0.0, "flange.force", 2.0),))
    with pytest.raises(ValueError, match="sets flange.force = 2 at its start"):
        sweep(scene, grid({"flange.force": [1.0]}), ["last(v)"])


def test_a_sweep_that_was_interrupted_is_taken_up_again(tmp_path: Path, compiler: None) -> None:
    runs, file = grid({"k13": np.linspace(40, 60, 60)}), tmp_path / "s.parquet"
    whole = sweep(four(), runs, ["last(v[1])"])

    def stop(done: int) -> None:
        if done >= 20:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep(four(), runs, ["last(v[1])"], file=file, progress=stop)
    assert not file.exists() and list(tmp_path.glob("s.parquet.parts/*.part"))
    with pytest.raises(ValueError, match="holds another sweep"):
        sweep(four(), runs, ["last(v[2])"], file=file, resume=True)
    other = Scene("four", build("four_particle").with_starts({"eta0": 0.7}), 0.5, 0.01)
    with pytest.raises(ValueError, match="holds another sweep"):
        sweep(other, runs, ["last(v[1])"], file=file, resume=True)
    seen: list[int] = []
    found = sweep(four(), runs, ["last(v[1])"], file=file, resume=True, jobs=1, progress=seen.append)
    assert seen[0] > 20  # what was known is not run again
    assert found.equals(whole) and pq.read_table(file).equals(whole)
    assert not (tmp_path / "s.parquet.parts").exists()
    with pytest.raises(ValueError, match="leave out --resume"):
        sweep(four(), runs, ["last(v[1])"], file=file, resume=True)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], compiler: None) -> None:
    file = tmp_path / "s.parquet"
    words = ["sweep", "four_particle", "--vary", "k13=40:60:3", "--vary", "m[1]=1,2", "--measure", "max(v[*])"]
    assert main([*words, "--stop", "0.2", "--step", "0.01", "-o", str(file)]) == 0
    said = capsys.readouterr().out
    assert "6 runs of 120 steps" in said and "closed" in said
    found = pq.read_table(file)
    assert found.num_rows == 6 and found.column_names[:3] == ["k13", "m[1]", "max(v[1])"]
    best = int(np.argmax(found["max(v[1])"]))
    assert f"k13 = {found['k13'][best].as_py():g}, m[1] = {found['m[1]'][best].as_py():g}" in said


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--vary", "m[1]=-1:1:3"], 2, "refused for its values"),
        (["--vary", "k31=1"], 2, "did you mean"),
        (["--vary", "k13=1", "--jobs", "0"], 2, "--jobs 0"),
        (["--vary", "k13=1", "-o", "s.txt"], 2, "the ending must be .parquet or .csv"),
        (["--vary", "k13=1", "--resume"], 2, "name it"),
        (["--vary", "q[1]=5"], 3, "inconsistent start"),
    ],
)
def test_the_command_on_bad_input(
    words: list[str], code: int, said: str, capsys: pytest.CaptureFixture[str], compiler: None
) -> None:
    told = ["--measure", "last(v[1])", "--stop", "0.1", "--step", "0.01"]
    assert main(["sweep", "four_particle", *told, *words]) == code
    out, err = capsys.readouterr()
    assert said in out + err and "Traceback" not in err


def test_finished_runs_are_counted_once() -> None:
    """A block is counted when it ends, not again after each later one."""
    counted: list[int] = []

    class Errors(tuple[str, ...]):
        def __len__(self) -> int:
            counted.append(1)
            return super().__len__()

    class Runs:
        def take(self, rows: np.ndarray, first: int = 0) -> RunOutcomes:
            n = len(rows)
            return RunOutcomes(np.zeros((n, 1)), np.ones(n, int), np.zeros(n), Errors([""] * n))

        def stop(self) -> None: ...

    seen: list[int] = []
    design, blocks = grid({"m": np.arange(1.0, 513.0)}), 8
    found = taken(Threads(Runs, 1), design, None, seen.append)
    assert seen == [64 * (i + 1) for i in range(blocks)] and len(found.errors) == 512
    assert len(counted) <= 2 * blocks
