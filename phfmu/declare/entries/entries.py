"""Entries of a declaration in one form; wrong shapes and foreign symbols are reported and left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any

import casadi as ca

from phfmu.declare.energy import ClosedPair
from phfmu.declare.entries.coefficients import stacked
from phfmu.declare.entries.entry_kind import EntryKind
from phfmu.declare.error import Problem
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.declare.variable import ValueKind, Variable, VariableKind, _sx, key, time

_ENERGY = (ValueKind.STATE, ValueKind.PARAMETER)
_ALL = (ValueKind.STATE, ValueKind.COSTATE, ValueKind.ALGEBRAIC, ValueKind.INPUT, ValueKind.PARAMETER, ValueKind.TIME)
#: what each entry may depend on (z2: the given effort of an algebraic variable; L, e: columns and restitutions of jumps)
ALLOWED: dict[EntryKind, tuple[ValueKind, ...]] = {
    **dict.fromkeys(
        (EntryKind.H, EntryKind.E, EntryKind.COSTATE, EntryKind.INVARIANT, EntryKind.COLUMN, EntryKind.RESTITUTION),
        _ENERGY,
    ),
    **dict.fromkeys(
        (EntryKind.J, EntryKind.R, EntryKind.B, EntryKind.EFFORT, EntryKind.OBSERVABLE, EntryKind.GUARD), _ALL
    ),
    EntryKind.CONSTRAINT: (*_ENERGY, ValueKind.TIME),
    EntryKind.SOURCE: (ValueKind.PARAMETER, ValueKind.TIME),
    EntryKind.BOUND: (ValueKind.ALGEBRAIC,),
}
#: and which variables it may stand on, where that is not states and algebraic variables
_ON: dict[EntryKind, tuple[ValueKind, ...]] = {
    **dict.fromkeys(
        (EntryKind.E, EntryKind.COSTATE, EntryKind.CLOSED, EntryKind.CORRECT, EntryKind.COLUMN), (ValueKind.STATE,)
    ),
    **dict.fromkeys((EntryKind.EFFORT, EntryKind.CONSTRAINT), (ValueKind.ALGEBRAIC,)),
    **dict.fromkeys((EntryKind.J, EntryKind.R), (ValueKind.STATE, ValueKind.ALGEBRAIC, ValueKind.INPUT)),
}
_WORDS = {
    ValueKind.STATE: "states",
    ValueKind.COSTATE: "costates",
    ValueKind.ALGEBRAIC: "algebraic variables",
    ValueKind.INPUT: "inputs",
    ValueKind.PARAMETER: "parameters",
    ValueKind.TIME: "time",
}


@dataclass(frozen=True, slots=True)
class Symbol:
    """The meaning of a scalar symbol of a declaration, and its name."""

    kind: ValueKind
    name: str


@dataclass(frozen=True, eq=False)
class Entry:
    """A sound expression: `rows` its variables, `origin` the declared thing."""

    what: EntryKind
    label: str
    expr: ca.SX
    rows: tuple[Variable | Port, ...] = ()
    origin: Any = None

    def names(self) -> list[str]:
        """Scalar names of the rows."""
        return [n for v in self.rows for n in v.names()]


@dataclass(frozen=True, eq=False)
class PairEntry:
    """A sound closed-form pair with its increment symbols d and the expressions at (x, d)."""

    label: str
    origin: ClosedPair
    x: ca.SX
    d: ca.SX
    ebar: ca.SX | None
    zbar: ca.SX | None


@dataclass
class Entries:
    """The sound entries of `model` and the problems of the others."""

    model: PHDAE
    known: dict[int, Symbol] = field(init=False)
    sound: list[Entry] = field(default_factory=list)
    pairs: list[PairEntry] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    #: hashes of the algebraic variables whose entries were left out: nothing is known about them
    doubtful: set[int] = field(default_factory=set)
    #: True if every entry that makes z from H and E is sound
    complete: bool = True

    def __post_init__(self) -> None:
        m = self.model
        self.known = {time.element_hash(): Symbol(ValueKind.TIME, "time")}
        declared = (
            (ValueKind.STATE, m.states),
            (ValueKind.ALGEBRAIC, m.algebraics),
            (ValueKind.PARAMETER, m.parameters),
        )
        for kind, variables in declared:
            for v in variables:
                for j, name in enumerate(v.names()):
                    self.known[v.sx[j].element_hash()] = Symbol(kind, name)
                    if kind is ValueKind.STATE:
                        self.known[v.z[j].element_hash()] = Symbol(ValueKind.COSTATE, f"z of {name}")
        for port in m.ports:
            for j in range(port.u.numel()):
                self.known[port.u[j].element_hash()] = Symbol(ValueKind.INPUT, f"input {j + 1} of {port.name}")

    def of(self, *what: EntryKind) -> list[Entry]:
        """Sound entries of these kinds."""
        return [e for e in self.sound if e.what in what]

    def kind(self, v: Variable | Port) -> ValueKind | None:
        """Kind of a variable, "" if it is not declared."""
        found = self.known.get(key(v))
        return None if found is None else found.kind

    def leave_out(self, what: EntryKind, rows: Sequence[Variable | Port]) -> None:
        self.doubtful |= {s.element_hash() for v in rows for s in ca.vertsplit(v.sx)}
        self.complete &= what not in (EntryKind.H, EntryKind.E)

    def add(
        self, what: EntryKind, label: str, expr: Any, shape: tuple[int, int] | None, rows=(), origin: Any = None,
        remedy: str = "make it as large as the variables and ports it connects",
    ) -> bool:  # fmt: skip
        """File an expression; True if its shape, rows and symbols are right; `remedy` of a wrong shape."""
        matrix = as_matrix(expr, shape if what in (EntryKind.E, EntryKind.B) else None)
        ok = self._rows(what, label, rows)
        if matrix is None:
            self._problem(
                "shape",
                label,
                f"{expr!r} is not an expression",
                "give numbers or expressions of the variables",
            )
            ok = False
        elif shape is not None and matrix.shape != shape:
            self._problem(
                "shape", label, f"is {matrix.shape[0]} x {matrix.shape[1]}, expected {shape[0]} x {shape[1]}", remedy,
            )  # fmt: skip
            ok = False
        elif not self.symbols(what, label, matrix):
            ok = False
        if not ok or matrix is None:
            self.leave_out(what, rows)
            return False
        self.sound.append(Entry(what, label, matrix, tuple(rows), origin))
        return True

    def symbols(self, what: EntryKind, label: str, expr: ca.SX) -> bool:
        """True if `expr` depends on declared symbols of the kinds allowed for `what` only."""
        ok = True
        for s in ca.symvar(expr):
            found = self.known.get(s.element_hash())
            if found is not None and found.kind in ALLOWED[what]:
                continue
            name = str(s) if found is None else found.name
            ok = False
            allowed = " and ".join(_WORDS[k] for k in ALLOWED[what])
            if found is not None:
                rule = "source" if what is EntryKind.SOURCE else "symbol"
                self._problem(
                    rule,
                    label,
                    f"depends on '{name}', one of the {_WORDS[found.kind]}",
                    f"it may depend on {allowed} only",
                )
                continue
            close = get_close_matches(name, [k.name for k in self.known.values()], 3)
            same = name in close
            hint = f"; close: {', '.join(close)}" if close and not same else ""
            text = "is the symbol of another variable of the same name" if same else "is not declared" + hint
            self._problem(
                "symbol",
                label,
                f"symbol '{name}' {text}",
                "list its variable in the declaration, the very same object",
            )
        return ok

    def _rows(self, what: EntryKind, label: str, rows: Sequence[Variable | Port]) -> bool:
        allowed = _ON.get(what, (ValueKind.STATE, ValueKind.ALGEBRAIC))
        bad = [v for v in rows if self.kind(v) not in allowed]
        for v in bad:
            words = " or ".join(_WORDS[k] for k in allowed)
            kind = self.kind(v)
            is_what = "is not declared" if kind is None else f"is one of the {_WORDS[kind]}"
            self._problem(
                "symbol",
                label,
                f"stands on '{v.name}', which {is_what}",
                f"use one of the {words} of this model",
            )
        return not bad

    def rows_known(self, what: EntryKind, label: str, rows: Sequence[Variable]) -> bool:
        return self._rows(what, label, rows)

    def _problem(self, rule: str, label: str, message: str, remedy: str) -> None:
        self.problems.append(Problem(rule, label, message, remedy))


def as_matrix(value: Any, shape: tuple[int, int] | None = None) -> ca.SX | None:
    """`value` as an expression; a scalar stands for a multiple of the identity where `shape` is square."""
    try:
        matrix = ca.SX(_sx(value))
    except Exception:  # whatever CasADi makes of strings, None, objects
        return None
    if shape is not None and matrix.numel() == 1 and shape[0] == shape[1] > 1:
        matrix = matrix * ca.SX.eye(shape[0])
    return matrix


def normal_form(e: Entries) -> None:
    """Fill `e` with all entries of its model."""
    m = e.model
    for what, blocks in ((EntryKind.J, m.structure), (EntryKind.R, m.dissipation)):
        for b in blocks:
            n = sum(v.n for v in b.variables)
            label = f"{what} block on {', '.join(v.name for v in b.variables)}"
            e.add(what, label, b.matrix, (n, n), b.variables, b)
    for where, value in m.E.items():
        rows = stacked(where)
        n, matrix = sum(v.n for v in rows), as_matrix(value)
        if matrix is not None and matrix.shape == (n, 1) and n > 1:
            value = ca.diag(matrix)
        e.add(EntryKind.E, f"E of {', '.join(repr(v.name) for v in rows)}", value, (n, n), rows)
    for v, value in m.z.items():
        e.add(
            EntryKind.EFFORT if v.kind is VariableKind.ALGEBRAIC else EntryKind.COSTATE,
            f"z of '{v.name}'",
            value,
            (v.n, 1),
            (v,),
            v,
        )
    for i, term in enumerate(m.energies):
        label = f"energy term {i + 1}" + (f" of {term.owner}" if term.owner else "")
        if e.add(EntryKind.H, label, term.expr, (1, 1), origin=term) and term.invariant is not None:
            e.add(EntryKind.INVARIANT, f"invariant of {label}", term.invariant, (1, 1), origin=term)
        e.rows_known(EntryKind.CORRECT, label, term.correct)
    for c in m.constraints:
        e.add(EntryKind.CONSTRAINT, f"constraint '{c.multiplier.name}'", c.g, (c.multiplier.n, 1), (c.multiplier,), c)
    for o in m.observables:
        e.add(EntryKind.OBSERVABLE, f"observable '{o.name}'", o.expr, (max(o.expr.numel(), 1), 1), origin=o)
    _ports(e)
    for event in m.state_events:
        e.add(EntryKind.GUARD, f"guard '{event.guard.name}'", event.guard.expr, (1, 1), origin=event)
        if event.jump is not None:
            label = f"jump '{event.guard.name}'"
            e.add(EntryKind.RESTITUTION, f"{label}: restitution", event.jump.restitution, (1, 1), origin=event)
            for v, column in event.jump.on.items():
                e.add(EntryKind.COLUMN, f"{label}: column on '{v.name}'", column, (v.n, 1), (v,), event)
    for i, pair in enumerate(m.closed):
        _closed(e, pair, f"closed-form pair {i + 1}")


def _ports(e: Entries) -> None:
    for p in e.model.ports:
        for v, coefficient in p.on.items():
            e.add(EntryKind.B, f"port '{p.name}': B on '{v.name}'", coefficient, (v.n, p.n), (v,), p, _columns(p, v))
        if p.u.shape != (p.n, 1):
            e._problem("shape", f"port '{p.name}'", f"u has {p.u.numel()} entries, expected {p.n}", "leave u out")
        if p.source is not None:
            e.add(EntryKind.SOURCE, f"source of '{p.name}'", p.source, (p.n, 1), origin=p)
        if p.bound is not None:
            e.add(EntryKind.BOUND, f"port '{p.name}': bound", ca.vertcat(*p.bound), (p.n, 1), origin=p)


def _columns(p: Port, v: Variable) -> str:
    """The remedy for coefficients of a port that do not fit a variable: its size, or other coefficients."""
    if p.size is None and v.n > 1:
        return (
            f"give the port size={v.n} (a pair for each entry of '{v.name}'), or a column of {v.n} numbers (one pair)"
        )
    pairs = f"{p.n} pairs (size={p.n})" if p.size else "one pair (no size)"
    return f"the port has {pairs} and '{v.name}' {v.n} entries: give a row for each entry, a column for each pair"


def _closed(e: Entries, pair: ClosedPair, label: str) -> None:
    n = sum(v.n for v in pair.variables)
    x, d = ca.vertcat(*(v.sx for v in pair.variables)), ca.SX.sym("d", n)
    ok = e.rows_known(EntryKind.CLOSED, label, pair.variables)
    parts = [
        (EntryKind.H, "H", pair.hamiltonian, (1, 1)),
        (EntryKind.E, "E", pair.E, (n, n)),
        (EntryKind.COSTATE, "z", pair.z, (n, 1)),
    ]
    discrete = {n: ca.SX(f(x, d)) for n, f in (("ebar", pair.ebar), ("zbar", pair.zbar)) if f is not None}
    for what, name, expr, shape in (*parts, *((EntryKind.H, name, expr, (n, 1)) for name, expr in discrete.items())):
        if name.endswith("bar"):
            (expr,) = ca.substitute([ca.SX(expr)], [d], [x])  # d counts as known
        before = len(e.sound)
        ok = e.add(what, f"{label}: {name}", expr, shape, origin=pair) and ok
        del e.sound[before:]
    if ok:
        e.pairs.append(PairEntry(label, pair, x, d, discrete.get("ebar"), discrete.get("zbar")))
    else:
        e.leave_out(EntryKind.E, pair.variables)
