"""Names of what a model tells stand in one place: tables, units, audits and pictures take them from there."""

from __future__ import annotations

import ast
from pathlib import Path

import phfmu
from phfmu import Monolithic, PythonInstance, build_model
from phfmu.components.library import build
from phfmu.fmu.export.variables import variables
from phfmu.signals import CONSTRAINT, END, ENERGY, LEDGER, MEAN, STEP_LEDGER, quantities, total

ROOT = Path(phfmu.__file__).parent
PARTS = {MEAN, END, ENERGY, CONSTRAINT, "energy.", ".energy."} | {total(name) for name, _, _ in (*LEDGER, *STEP_LEDGER)}


def written(text: str) -> list[str]:
    """Parts of names that stand in a source, alone or in an f-string."""
    return [n.value for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Constant) and n.value in PARTS]


def test_parts_of_names_are_written_once() -> None:
    rooms = [ROOT / room for room in ("fmu", "network", "audit", "report", "cli")]
    found = {p.name: written(p.read_text(encoding="utf-8")) for room in rooms for p in room.rglob("*.py")}
    assert {name: parts for name, parts in found.items() if parts} == {}
    assert written('n = f"{port}.energy"') == [".energy"]


def test_tables_units_and_quantities_have_the_same_names() -> None:
    """A table has what is calculated by an instance, a unit has all; nothing has two names or a second unit."""
    model = build_model(build("two_machine").declaration())
    told = {q.name: q for q in quantities(model)}
    unit = variables(model)
    assert [v.name for v in unit] == list(told)
    assert all((v.unit, v.causality) == (told[v.name].unit, told[v.name].causality) for v in unit)
    instance = PythonInstance(model)
    columns = Monolithic(model, instance).names
    assert columns == [q.name for q in told.values() if q.block in instance.layout and q.causality != "independent"]
    assert told["bus1.v[1]"].unit == "V" and told[total("stored", "m1")].unit == "J"
