"""What a unit answers, as data: the outcome its solver had, told in a message, is found at the border and nowhere else."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from phfmu.cli import main
from phfmu.engine.build.runtime_sources import RUNTIME
from phfmu.fmu.importer import reader
from phfmu.fmu.importer.refusal import UnitCallError
from phfmu.outcome.status import Status

NUMBERS = (
    "Worst: x, scaled residual 1 (rounding floor 1e-16), last update 2 after 3 iterations, in [0 s, 1 s]. The component"
)


@pytest.mark.parametrize("status", Status)
def test_a_unit_of_this_package_tells_its_status(status: Status) -> None:
    for words in (f"fmi3DoStep: {status.value}. {NUMBERS}", f"fmi2GetDirectionalDerivative: {status.value}"):
        assert UnitCallError("u", "fmi3DoStep", "discard", ["other words", words]).status is status


@pytest.mark.parametrize(
    "words",
    [
        "",
        "solver: a value is not finite, giving up",
        "I think that the Newton matrix is singular: an equation is missing",
        "x",
    ],
)
def test_other_words_are_no_status(words: str) -> None:
    assert UnitCallError("u", "fmi3DoStep", "discard", [words]).status is None
    assert UnitCallError("u", "fmi3DoStep", "discard").status is None


def test_advice_names_couplings_that_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["run", "--help"])
    offered = re.search(r"--coupling \{(.*?)\}", capsys.readouterr().out)
    assert offered is not None
    room = Path(reader.__file__).parent
    named = {n for p in room.glob("*.py") for n in re.findall(r"--coupling ([\w-]+\w)", p.read_text(encoding="utf-8"))}
    assert named and named <= set(offered[1].split(","))


def test_files_of_units_and_instances_hold_one_concept() -> None:
    room = Path(reader.__file__).parent
    files = [*room.rglob("*.py"), *room.rglob("*.c"), RUNTIME / "instance.c", RUNTIME / "memory.c"]
    assert {p.name: n for p in files if (n := len(p.read_text(encoding="utf-8").splitlines())) > 450} == {}


def test_the_reader_compares_no_texts_of_errors() -> None:
    tree = ast.parse(Path(reader.__file__).read_text(encoding="utf-8"))
    texts = [
        n.lineno
        for n in ast.walk(tree)
        if isinstance(n, ast.Compare)
        and any(isinstance(c, ast.Call) and getattr(c.func, "id", "") == "str" for c in (n.left, *n.comparators))
    ]
    assert texts == []
