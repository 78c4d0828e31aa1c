"""Terms: values, rows and findings are typed, and what a technique knows is in its own room."""

from __future__ import annotations

import ast
from dataclasses import dataclass, fields
from pathlib import Path

import pytest

import phfmu
from phfmu.components.library import build
from phfmu.declare.variable import ValueKind
from phfmu.schemes.collocated import Collocated
from phfmu.schemes.constraints.impulses import Impulses
from phfmu.schemes.two_level import TwoLevel
from phfmu.terms.extraction.extract import extract
from phfmu.terms.hidden import HiddenConstraints
from phfmu.terms.located import Constant, Row, RowAt, ValueAt
from phfmu.terms.rank import ConstraintsAtStart, at_start
from phfmu.terms.term import CONSTRAINT, Terms
from phfmu.terms.velocities import Velocities, velocity_of
from tests.sources import nodes

ROOT = Path(phfmu.__file__).parent
ROOMS = ("terms", "plan", "schemes", "discretise", "schur")


@pytest.fixture(scope="module")
def particles() -> Terms:
    return extract(build("four_particle"))


def test_terms_and_constants_of_a_model_are_typed(particles: Terms) -> None:
    for term in particles.terms:
        assert {type(kind) for kind in term.local} <= {ValueKind} and term.local.keys() == term.index.keys()
        assert all(isinstance(row, RowAt) and isinstance(row.kind, Row) for row in term.rows)
        assert all(len(term.index[kind]) == s.numel() for kind, s in term.local.items())
    assert particles.constants and all(isinstance(c, Constant) for c in particles.constants)
    at = particles.state_names.index("q[1]")
    moved = [c for c in particles.constants if c.row == RowAt(Row.BALANCE, at)]
    assert [(c.source, c.value) for c in moved] == [(ValueAt(ValueKind.COSTATE, velocity_of(particles)[at]), 1.0)]


def short_strings(path: Path) -> list[tuple[str, int]]:
    """Comparisons with strings of one or two characters, the kinds of old."""
    compared = (n for n in nodes(path) if isinstance(n, ast.Compare))
    return [
        (path.name, n.lineno)
        for n in compared
        for side in (n.left, *n.comparators)
        for c in (side.elts if isinstance(side, ast.Tuple | ast.Set | ast.List) else (side,))
        if isinstance(c, ast.Constant) and isinstance(c.value, str) and len(c.value) in (1, 2)
        and not isinstance(n.comparators[0], ast.Attribute)
    ]  # fmt: skip


def test_no_kind_is_told_by_a_string() -> None:
    """`"z" in term.data` asks for a named expression: that is no kind."""
    assert [found for room in ROOMS for p in (ROOT / room).glob("*.py") for found in short_strings(p)] == []


def test_a_comparison_with_a_kind_of_old_is_seen(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text('if kind == "x" or row[0] in ("a", "y") or "z" in term.data:\n    pass\n')
    assert short_strings(tmp_path / "a.py") == [("a.py", 1), ("a.py", 1), ("a.py", 1)]


def test_the_plan_names_no_technique() -> None:
    """No identifier of the plan has the name of a scheme, a constraint, an impulse or what belongs to one."""
    words = (
        "velocit",
        "constraint",
        "impulse",
        "bare",
        "light",
        "collocated",
        "radau",
        "multiplier",
        "force",
        "two_level",
    )
    found = set()
    for path in (ROOT / "plan").glob("*.py"):
        for node in nodes(path):
            own = {ast.Name: "id", ast.Attribute: "attr", ast.FunctionDef: "name", ast.alias: "name", ast.arg: "arg"}
            name = str(getattr(node, own.get(type(node), ""), "")).lower()
            found |= {(path.name, name) for w in words if w in name}
    assert found == {("planner.py", "constraints")}  # PHDAE.constraints, for the remedy of a singular plan


def test_findings_belong_to_techniques(particles: Terms) -> None:
    """`Terms` has no field for one, and takes those of a technique that it has never heard of."""

    @dataclass(frozen=True)
    class Own:
        numbers: tuple[int, ...] = ()

    known = {
        "model",
        "n1",
        "na",
        "np",
        "pairs",
        "nu",
        "bound",
        "members",
        "terms",
        "constants",
        "observable_names",
        "findings",
    }
    assert {f.name for f in fields(Terms)} == known
    more = particles.having(Own((1, 2)))
    assert more.found(Own) == Own((1, 2)) and particles.found(Own) == Own() and more.terms is particles.terms
    assert more.found(Velocities) == particles.found(Velocities) != Velocities()
    started = at_start(more)
    assert set(started.found(ConstraintsAtStart).sizes) == {t.rows[0].index for t in particles.of(CONSTRAINT)}
    assert started.found(Own) == Own((1, 2)) and TwoLevel(1).prepare(started).found(Own) == Own((1, 2))


def test_impulses_are_found_by_the_scheme_that_has_them() -> None:
    terms = extract(build("smib").declaration())
    found = Collocated(1).prepare(terms).found(Impulses)
    assert found.pairs and set(found.pairs) <= terms.found(HiddenConstraints).rows
    assert terms.found(Impulses) == Collocated(1, impulses=False).prepare(terms).found(Impulses) == Impulses()
