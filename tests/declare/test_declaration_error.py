"""Errors of a declaration are data: entry, reason, remedy, all that was found; nothing finds them again in a text."""

from __future__ import annotations

import ast
import math
import pickle
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import pytest

import phfmu
from phfmu import (
    ELECTRICAL,
    PHDAE,
    DeclarationError,
    Port,
    Problem,
    SystemTransformation,
    algebraic,
    build_model,
    check,
    energy,
    skew,
    state,
)
from phfmu.declare.error import RULES
from phfmu.schemes.named import named_scheme
from tests.sources import nodes

#: it asks what a user reads
READERS = {"studies/stress/case.py"}


def error_of(call: Callable[[], object]) -> DeclarationError:
    with pytest.raises(DeclarationError) as caught:
        call()
    return caught.value


def short_circuit() -> PHDAE:
    """Two ideal sources hold one state: a and b are both to make x = 0."""
    x, a, b = state("x", start=0.0), algebraic("a"), algebraic("b")
    return PHDAE("short", states=(x,), algebraics=(a, b), energies=(energy(x**2 / 2),),
                 structure=(skew(a, x, 1.0), skew(b, x, 1.0)))  # fmt: skip


def test_an_error_says_what_why_and_what_to_do():
    e = error_of(lambda: named_scheme(short_circuit(), "two-level"))
    assert (e.entry, e.reason, e.remedy, e.rule) == (
        "short", "has no holonomic constraints", "use --scheme collocated", "constraint",
    )  # fmt: skip
    assert str(e) == "short: has no holonomic constraints; use --scheme collocated"


def test_the_check_tells_the_parts_of_an_error_of_the_planner():
    """The remedy of the planner is the check's; before, it was what came after the last stop of the text."""
    e = error_of(lambda: build_model(short_circuit()))
    (found,) = check(short_circuit())
    assert found == Problem("solvability", e.entry, e.reason, e.remedy) and e.rule == "singular"
    assert "cannot be solved for" in e.reason and e.remedy.startswith("check for an ideal loop")


def test_marks_within_a_reason_stay_there():
    q, v, lam = state("q", start=1.0), state("v"), algebraic("lam")
    model = PHDAE("p", states=(q, v), algebraics=(lam,), energies=(energy(v.sx**2),), structure=(skew(q, v, 1.0),))
    e = error_of(lambda: build_model(replace(model, E={(q, v): ca.SX([[1.0, 1.0], [1.0, 1.0]])})))
    assert e.entry == "p: E of 'q', 'v'" and "; " not in e.reason and e.remedy.endswith("reduce_descriptor(model)")


@pytest.mark.parametrize(
    "error", [DeclarationError("a", "b", "c", "d"), DeclarationError.of([Problem("r", "a", "b", "c")] * 2)]
)
def test_errors_go_between_processes(error):
    other = pickle.loads(pickle.dumps(error))
    assert other.problems == error.problems and str(other) == str(error) and other.rule == error.rule


def nan_twice() -> object:
    x, y = state("x", start=math.nan), state("y", start=math.inf)
    return build_model(PHDAE("m", states=(x, y), energies=(energy(x**2 + y**2),)))


def wrong_parts() -> object:
    parts: dict[str, Any] = {"states": ("x", 2), "ports": Port("p", ELECTRICAL, "effort", {})}
    return PHDAE("m", **parts)


def wrong_maps() -> object:
    q, w = state("q", 2), state("w", 2)
    return SystemTransformation({q: w[0] * phfmu.time}, (w,), [[1.0]])


@pytest.mark.parametrize(
    ("call", "entries"),
    [
        (nan_twice, ["variable 'x'", "variable 'y'"]),
        (wrong_parts, ["m"] * 3),
        (lambda: named_scheme(short_circuit(), order=7, gradient="steep", closure="shut"),
         ["order 7", "gradient steep", "closure shut"]),
        (wrong_maps, ["phi of 'q'", "U", "phi or U"]),
    ],
    ids=["starts", "parts", "scheme", "maps"],
)  # fmt: skip
def test_all_that_is_wrong_is_told_at_once(call, entries):
    e = error_of(call)
    assert [p.entry for p in e.problems] == entries and e.entry == entries[0]
    assert all(p.reason and p.remedy for p in e.problems) and len(str(e).splitlines()) == len(entries)


def test_every_rule_that_is_given_is_listed():
    """By calls with constant words in the files below the check, whose own rules have a table and tests."""
    root, given = Path(phfmu.__file__).parent, set()
    files = [p for p in root.rglob("*.py") if p.relative_to(root).parts[0] not in ("checks", "components")]
    raising = [p for p in files if "DeclarationError(" in p.read_text(encoding="utf-8")]
    for call in (n for p in raising for n in nodes(p) if isinstance(n, ast.Call)):
        if isinstance(call.func, ast.Name) and call.func.id == "DeclarationError" and len(call.args) > 3:
            assert isinstance(call.args[3], ast.Constant)
            given.add(call.args[3].value)
    assert len(given) > 10 and given <= RULES | {""}


# -- nothing matches the words of an error ------------------------------------------------------------------------------


def matched(code: Iterable[ast.AST]) -> Iterator[int]:
    """Lines of `x in str(e)`, or of `in` its args, for a caught e, also by way of a name."""
    for handler in code:
        if not isinstance(handler, ast.ExceptHandler) or not handler.name:
            continue
        texts = {handler.name}
        for node in ast.walk(handler):
            if isinstance(node, ast.Assign) and names(node.value) & texts:
                texts |= {t.id for t in node.targets if isinstance(t, ast.Name)}
        for node in ast.walk(handler):
            if isinstance(node, ast.Compare) and any(isinstance(o, ast.In | ast.NotIn) for o in node.ops):
                told = (
                    c for c in node.comparators if not isinstance(c, ast.Attribute)
                )  # data of the error are asked for
                if any(names(c) & texts for c in told):
                    yield node.lineno


def names(node: ast.AST) -> set[str]:
    return {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}


def test_no_file_finds_an_error_again_in_its_text():
    root = Path(phfmu.__file__).parent
    catching = re.compile(r"\bexcept\b.*\bas\b")
    paths = (p for p in root.rglob("*.py") if catching.search(p.read_text(encoding="utf-8")))
    files = {p.relative_to(root).as_posix(): p for p in paths}
    found = {n: [*matched(nodes(p))] for n, p in files.items() if n not in READERS}
    assert {n: lines for n, lines in found.items() if lines} == {}


def test_a_match_is_seen():
    form = "try:\n    f()\nexcept ValueError as e:\n    {}\n"
    assert [*matched(ast.walk(ast.parse(form.format("ok = 'x' in str(e)"))))] == [4]
    assert [*matched(ast.walk(ast.parse(form.format("t = str(e)\n    ok = any(w not in t for w in ws)"))))] == [5]
    assert [*matched(ast.walk(ast.parse(form.format("ok = e.rule in REASONS"))))] == []
