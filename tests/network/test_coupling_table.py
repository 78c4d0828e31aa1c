"""Couplings by rows of one table: the command line, the choice by name and the documentation read it, also a new row."""

from __future__ import annotations

import subprocess
import sys

import pytest

from phfmu.cli import main
from phfmu.network.couplings.choice.coupling_choice import named_coupling, repeats
from phfmu.network.couplings.coupling_table import COUPLINGS, CouplingRow
from phfmu.network.couplings.jacobi import Jacobi
from phfmu.target import scene

APART = [row for row in COUPLINGS.values() if row.apart]


@pytest.mark.parametrize("row", APART, ids=lambda row: row.name)
def test_a_row_leads_to_its_coupling(row: CouplingRow) -> None:
    network = scene("oscillator").system
    found = named_coupling(row.name, network)
    assert found.order == row.kind.order and str(found.order) in row.order and found.nodes == bool(row.at_nodes)
    assert repeats(row.name) == row.kind.repeats == ("steps back" in row.needs)
    assert row.name in found.words


def test_the_choice_may_repeat_steps_where_nobody_asked() -> None:
    assert repeats(None) and repeats("auto") and repeats("monolithic")


def test_a_name_that_is_none_is_refused_with_those_there_are() -> None:
    with pytest.raises(ValueError, match="no coupling 'jacoby' of members; did you mean jacobi?"):
        named_coupling("jacoby", scene("oscillator").system)
    with pytest.raises(ValueError, match="no coupling 'monolithic' of members"):
        named_coupling("monolithic", scene("oscillator").system)


def test_a_new_row_is_asked_for_by_name(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """A row and its class, and nothing else: help, choice, options and words follow."""
    made = []

    class Own(Jacobi):
        def __init__(self) -> None:
            super().__init__()
            made.append(self)

    monkeypatch.setattr(sys.modules[__name__], "Own", Own, raising=False)
    row = CouplingRow("own", "what nobody had", "1", "nothing", f"{__name__}.Own", "lagged for a test")
    monkeypatch.setitem(COUPLINGS, "own", row)
    with pytest.raises(SystemExit):
        main(["run", "--help"])
    assert "own: what nobody had" in " ".join(capsys.readouterr().out.split())
    assert (
        main(["run", "oscillator", "--coupling", "own", "--engine", "python", "--stop", "0.002", "--step", "0.001"])
        == 0
    )
    assert "lagged for a test" in (out := capsys.readouterr().out) and "own coupling" in out and len(made) == 1
    assert main(["run", "oscillator", "--coupling", "own", "--unconverged", "halve"]) == 2
    assert "own does not iterate" in capsys.readouterr().err
    assert main(["run", "oscillator", "--coupling", "newton", "--ecco", "0.1"]) == 2
    said = capsys.readouterr().err  # pages that the same process ran may have rows of their own
    assert "add --coupling gauss-seidel or jacobi" in said and "or own, or leave it out" in said


def test_the_table_imports_nothing_of_the_package() -> None:
    """The command line reads it for its help."""
    code = (
        "import sys; import phfmu.network.couplings.coupling_table\n"
        "print([m for m in sys.modules if m in ('numpy', 'casadi') or m.startswith('phfmu.network.couplings.')])"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert told.strip() == "['phfmu.network.couplings.coupling_table']"
