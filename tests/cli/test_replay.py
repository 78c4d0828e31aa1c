"""A run is run again by its audit: bits that differ are found by step, member and quantity; other changes are named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu.audit.difference import first_differences
from phfmu.audit.log.archive import read
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.reference.python import PythonInstance
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.outcome.steps import Steps
from phfmu.runs.march import march
from tests.cli.commands import MODELS, Cli

#: the place of a free mass: no energy follows from it, so no ledger tells of it
WITHOUT_ENERGY = ("q",)


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("m.py").write_text(MODELS)


@dataclass
class Place:
    """An instance whose place, from which no energy follows, has a bit turned."""

    instance: Any


def flipped(instance: Any) -> None:
    """Turns a bit in the middle of the mantissa of the largest state with energy, in the memory of the next step."""
    place, instance = isinstance(instance, Place), instance.instance if isinstance(instance, Place) else instance
    x = instance.x
    names = [n for v in instance.model.declaration.states for n in v.names()]
    old = max((v for n, v in zip(names, x, strict=True) if (n in WITHOUT_ENERGY) is place), key=abs)
    new = (np.array([old]).view(np.int64) ^ (1 << 30)).view(np.float64)[0]
    if isinstance(instance, PythonInstance):
        state = instance.get_state()
        state.x[:-1][state.x[:-1] == old] = new
        instance.set_state(state)
        return
    assert isinstance(instance, NativeInstance)
    state = instance.get_state()
    assert old.tobytes() in state
    instance.set_state(state.replace(old.tobytes(), new.tobytes(), 1))


def flip_before(k: int, kind: type, of: Callable[[Any], Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Steppers of a kind have a bit of an instance turned before step k."""
    advance = kind.advance

    def broken(self: Any, t0: float, h: float, n: int, first: int = 0) -> Steps:
        if not first <= k < first + n:
            return advance(self, t0, h, n, first)
        parts = [advance(self, t0, h, k - first, first)] if k > first else []
        flipped(of(self))
        return Steps.joined([*parts, advance(self, t0, h, n - (k - first), k)])

    monkeypatch.setattr(kind, "advance", broken)


@pytest.mark.parametrize(
    "words",
    [
        ["two_machine", "--stop", "0.02"],
        ["two_machine", "--stop", "0.02", "--coupling", "newton", "--order", "4"],
        ["m.py:joined", "--stop", "2", "--step", "0.01", "--coupling", "gauss-seidel"],
        ["oscillator", "--stop", "1", "--engine", "python"],
        ["oscillator", "--stop", "1", "--engine", "fmu"],
        ["oscillator", "--stop", "1", "--rtol", "1e-6"],
        ["four_particle", "--stop", "0.1"],
        ["bouncing_ball", "--stop", "1"],
    ],
    ids=" ".join,
)
def test_a_run_is_the_same_again(words: list[str], cli: Cli) -> None:
    assert cli("run", *words, "--audit", "a.parquet", "--quiet")[0] == 0
    code, out, _ = cli("replay", "a.parquet")
    assert code == 0, out
    assert "every bit as it was" in out and "changed" not in out


@pytest.mark.parametrize("engine", ["native", "python"])
def test_a_turned_bit_is_found_at_its_step(engine: str, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cli("run", "oscillator", "--engine", engine, "--audit", "a.parquet", "--quiet")[0] == 0
    flip_before(37, Monolithic, lambda s: s.instance, monkeypatch)
    code, out, _ = cli("replay", "a.parquet")
    assert code == 1
    assert "first difference: step 37 " in out and "component mass1" in out
    assert "files, libraries and machine are as they were" in out


@pytest.mark.parametrize(
    ("words", "member"),
    [
        (["two_machine", "--stop", "0.02", "--coupling", "newton"], "m1"),
        (["two_machine", "--stop", "0.02", "--coupling", "newton", "--order", "4"], "m2"),
        (["two_machine", "--stop", "0.02", "--coupling", "newton"], "line"),
        (["two_machine", "--stop", "0.02", "--coupling", "newton", "--hash-states", "1"], "m2"),
        (["m.py:joined", "--stop", "2", "--step", "0.01", "--coupling", "jacobi"], "m"),
        (["m.py:joined", "--stop", "2", "--step", "0.01", "--coupling", "jacobi"], "s"),
        (["m.py:joined", "--stop", "2", "--step", "0.01", "--coupling", "newton", "--engine", "python"], "s"),
    ],
)
def test_a_turned_bit_is_found_in_its_member(
    words: list[str], member: str, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert cli("run", *words, "--audit", "a.parquet", "--quiet")[0] == 0
    flip_before(11, Coupled, lambda s: next(m for m in s.joined.members if m.name == member).instance, monkeypatch)
    code, out, _ = cli("replay", "a.parquet")
    assert code == 1
    assert out.startswith("first difference: step 11 ") and f"component {member}:" in out.splitlines()[0], out


@pytest.mark.parametrize("coupling", ["newton", "gauss-seidel"])
@pytest.mark.parametrize(("each", "found"), [(1, 11), (5, 14)])
def test_a_turned_bit_of_a_state_without_energy_is_found_by_its_hash(
    each: int, found: int, coupling: str, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The place of a free mass, at the end of the first step from it that is hashed, and in no other member."""
    words = ["m.py:joined", "--stop", "2", "--step", "0.01", "--coupling", coupling]
    assert cli("run", *words, "--hash-states", str(each), "--audit", "a.parquet", "--quiet")[0] == 0
    assert cli("run", *words, "--audit", "b.parquet", "--quiet")[0] == 0
    flip_before(11, Coupled, lambda s: Place(s.joined.members[0].instance), monkeypatch)
    assert cli("replay", "b.parquet")[0] == 0  # no ledger tells of it
    code, out, _ = cli("replay", "a.parquet")
    assert code == 1
    first = out.splitlines()
    assert first[0].startswith(f"first difference: step {found} from t = {found * 0.01:.9g} s: hash of m was "), out
    assert not any("also" in line for line in first), out


def states_of(path: str) -> dict[tuple[int, str], str]:
    """The hashes of members in an audit, by step and name."""
    table = read(path)
    kinds, *columns = (table[n].to_pylist() for n in ("row", "step", "component", "hash"))
    return {
        (step, name): found for kind, step, name, found in zip(kinds, *columns, strict=True) if kind == "hash" and name
    }


@pytest.mark.parametrize("order", ["2", "4"])
def test_members_have_the_same_hashes_native_and_as_units(order: str, cli: Cli) -> None:
    words = ["oscillator", "--coupling", "newton", "--order", order, "--stop", "0.5", "--hash-states", "2", "--quiet"]
    for name, more in (("native", []), ("fmi3", ["--engine", "fmu"]), ("fmi2", ["--engine", "fmu", "--fmi", "2.0"])):
        assert cli("run", *words, *more, "--audit", f"{name}.parquet")[0] == 0
    native = states_of("native.parquet")
    assert sorted(native) == [(k, n) for k in range(1, 50, 2) for n in ("mass1", "mass2", "spring12")]
    assert len(set(native.values())) == len(native) > 0
    assert states_of("fmi3.parquet") == states_of("fmi2.parquet") == native


@pytest.mark.parametrize(
    "words",
    [
        ["bouncing_ball", "--stop", "0.6", "--step", "0.01"],
        ["drive", "--stop", "0.01", "--rtol", "1e-4"],
        ["buffer", "--stop", "3", "--rtol", "1e-4"],
        ["rectifier", "--coupling", "newton", "--order", "4", "--stop", "0.008"],
        ["pendulum", "--stop", "0.3", "--engine", "fmu"],
    ],
    ids=" ".join,
)
def test_hashes_do_not_depend_on_how_steps_are_cut_into_blocks(
    words: list[str], cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, most in (("a", march.BLOCK), ("b", 8)):
        monkeypatch.setattr(march, "BLOCK", most)
        assert cli("run", *words, "--hash-states", "3", "--audit", f"{name}.parquet", "--quiet")[0] == 0
    assert states_of("a.parquet")
    assert first_differences(read("a.parquet"), read("b.parquet")) == []


def test_hashes_need_an_audit_file(cli: Cli) -> None:
    code, _, err = cli("run", "pendulum", "--stop", "1", "--hash-states", "3")
    assert code == 2
    assert "--hash-states 3 writes to the audit; give --audit FILE" in err
    assert cli("run", "pendulum", "--stop", "1", "--hash-states", "-3", "--audit", "a.parquet")[0] == 2


def test_another_input_is_named(cli: Cli) -> None:
    data = Path("force.csv")
    data.write_text("time,flange.force\n0,0\n0.5,1\n")
    assert cli("run", "m.py:pushed", "--input", "force.csv", "--audit", "a.parquet", "--quiet")[0] == 0
    assert cli("replay", "a.parquet")[0] == 0
    data.write_text("time,flange.force\n0,0\n0.5,2\n")
    code, out, _ = cli("replay", "a.parquet")
    assert code == 1
    assert out.startswith("changed: file force.csv: was ")
    assert "first difference: event at t = 0.5 s" in out and "flange.force" in out


def test_an_audit_without_its_origin_is_refused(cli: Cli) -> None:
    from phfmu.audit import AuditWriter, Ledger

    with AuditWriter("a.parquet") as sink:
        Ledger(sink).event(0.0, "input", message="x = 1")
    code, _, err = cli("replay", "a.parquet")
    assert code == 2
    assert "does not tell the options of its run" in err
