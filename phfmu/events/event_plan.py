"""State events as tables: guards and jumps as kernels with indices, the parameters that arm them, and those they set.

Guards are functions of values at an instant: costates are put in as functions of the states, inputs that are fed from inside as
what feeds them.  So a guard without algebraic variables costs no solve.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np

from phfmu.declare.error import DeclarationError
from phfmu.declare.event import StateEvent
from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import ValueKind, _sx, time
from phfmu.events.jump_tables import JumpTables, jump_tables
from phfmu.events.polynomial import Polynomial
from phfmu.plan.address import READ, Address, row
from phfmu.plan.plan import Floats, Group, Ints, Kernel, Powers
from phfmu.plan.spec import Spec, build
from phfmu.terms.canonical import Locator, make_term, member
from phfmu.terms.located import Row, RowAt, ValueAt
from phfmu.terms.rows import costate_symbols, costates, flow_expressions
from phfmu.terms.term import CONSTRAINT, Term, TermKind, Terms
from phfmu.terms.velocities import velocity_of

GUARD = TermKind("guard")


@dataclass(frozen=True)
class Settings:
    """Per event i the scalar parameters p[ptr[i]:ptr[i+1]] and a value for each."""

    ptr: Ints
    p: Ints
    value: Floats

    def of(self, i: int) -> slice:
        return slice(self.ptr[i], self.ptr[i + 1])


@dataclass(frozen=True, eq=False)
class EventPlan:
    """n state events of a model, in the order of the declaration.

    names, direction, nominal (n): of the guards;  groups: their kernels (stage 1), with x = [states | t], Y = [a | u] and the
    guards as rows;  rates: the same of d guard / dt, for those that are `rated` (n): 1 = it follows from states and inputs;
    solves: 1 if one reads algebraic variables;  when, sets, rest: see `StateEvent`;
    owner (n): component that books what the event loses
    """

    names: tuple[str, ...]
    direction: Powers
    nominal: Floats
    groups: tuple[Group, ...]
    rates: tuple[Group, ...]
    rated: Powers
    solves: int
    owner: Ints
    when: Settings
    sets: Settings
    rest: Settings
    jump: JumpTables | None
    polynomial: Polynomial

    @property
    def n(self) -> int:
        return len(self.names)

    @property
    def kernels(self) -> list[Kernel]:
        return [g.kernel for g in (*self.groups, *self.rates, *(() if self.jump is None else (self.jump.group,)))]


def event_plan(terms: Terms) -> Callable[[Polynomial], EventPlan]:
    """The state events of a model, perhaps none, for steps of any polynomial.  DeclarationError names what does not fit."""
    model = terms.model
    events = model.state_events
    index = {n: i for i, n in enumerate(n for v in model.parameters for n in v.names())}
    _require_modes(model, index)
    guards, locator = _guards(terms), Locator(model, terms.pairs)
    groups = _groups(terms, locator, guards)
    solves = any((g.yi < terms.na).any() for g in groups)
    rates = _rates(terms, locator, guards)
    return partial(
        EventPlan,
        tuple(e.guard.name for e in events),
        np.array([e.guard.direction for e in events], np.int8),
        np.array([e.guard.nominal for e in events], float),
        tuple(groups),
        tuple(_groups(terms, locator, rates)),
        np.array([i in rates for i in guards], np.int8),
        int(solves),
        np.array([_owner(terms.members, e) for e in events], np.int32),
        _settings(index, (e.when for e in events)),
        _settings(index, (e.sets for e in events)),
        _settings(index, (e.rest for e in events)),
        jump_tables(terms, events),
    )


def _owner(members: Sequence[str], e: StateEvent) -> int:
    """The component of the jump, else the one whose name the guard begins with."""
    if e.jump is not None and e.jump.owner:
        return member(members, e.jump.owner)
    begins = [m for m in members if e.guard.name.startswith(f"{m}.")]
    return member(members, max(begins, key=len, default=""))


def _settings(index: Mapping[str, int], values: Iterable[Mapping[str, float]]) -> Settings:
    listed = list(values)
    return Settings(
        np.cumsum([0, *map(len, listed)]).astype(np.int32),
        np.array([index[n] for v in listed for n in v], np.int32),
        np.array([x for v in listed for x in v.values()], float),
    )


def _require_modes(model: PHDAE, index: Mapping[str, int]) -> None:
    """Raise DeclarationError for names that are no scalar parameters, and for modes with energy in them."""
    for e in model.state_events:
        for name in sorted(e.named - index.keys()):
            raise DeclarationError(
                f"{model.name}: state event '{e.guard.name}'",
                f"'{name}' is no scalar parameter",
                f"name one of: {', '.join(list(index)[:12]) or 'none is declared'}",
                "symbol",
            )
    symbols = {n: s for v in model.parameters for n, s in zip(v.names(), ca.vertsplit(v.sx), strict=True)}
    stored = ca.vertcat(model.hamiltonian, *(ca.vec(ca.SX(_sx(m))) for m in model.E.values()))
    for name in model.modes:
        if ca.depends_on(stored, symbols[name]):
            raise DeclarationError(
                f"{model.name}: mode '{name}'",
                "is in the energy or in E, so setting it would change the energy stored",
                "let events set parameters of J, R or B, and the states jump",
                "energy",
            )


def _guards(terms: Terms) -> dict[int, tuple[str, ca.SX]]:
    """Label and expression at an instant of each guard, by the number of its event."""
    given = [(f"guard '{e.guard.name}'", ca.SX(_sx(e.guard.expr))) for e in terms.model.state_events]
    for label, expr in given:
        if expr.numel() != 1:
            reason = f"has {expr.numel()} entries"
            raise DeclarationError(f"{terms.model.name}: {label}", reason, "give one expression a guard", "shape")
    return dict(enumerate(zip((label for label, _ in given), at_instant(terms, given), strict=True)))


def _groups(terms: Terms, locator: Locator, rows: Mapping[int, tuple[str, ca.SX]]) -> list[Group]:
    """Kernels of expressions at an instant, by the number of their row; equal ones are instances of one."""
    specs, found = dict[tuple, Spec](), list[tuple[Term, Spec]]()
    for i, (label, expr) in rows.items():
        term = make_term(GUARD, {"f": expr}, locator, label, rows=[RowAt(Row.OBSERVABLE, i)])
        spec = specs.get(term.key) or specs.setdefault(term.key, _spec(term))
        found.append((term, spec))
    return [_table(terms, spec, [t for t, s in found if s is spec]) for spec in specs.values()]


def _rates(terms: Terms, locator: Locator, guards: Mapping[int, tuple[str, ca.SX]]) -> dict[int, tuple[str, ca.SX]]:
    """d guard / dt = (d guard / d x) f + d guard / d t, for guards of states whose rates f are at hand.

    Not at hand are the rates of algebraic variables, of states with a block of E, of those that forces of holonomic constraints
    act on, and rates that read algebraic variables or costates which are solved for.  A rate that is a number is of no use: such
    a guard does not turn back.
    """
    if not guards:
        return {}
    inputs = ca.vertcat(ca.SX(0, 1), *(p.port.u[p.j] for p in terms.pairs))
    f = ca.vertsplit(flow_expressions(terms, costate_symbols(terms.model), inputs)[0])
    velocity = velocity_of(terms) if terms.of(CONSTRAINT) else {}
    unknown = set(terms.with_descriptor()) | {
        velocity[i] for t in terms.of(CONSTRAINT) for i in t.index[ValueKind.STATE]
    }
    hidden = {ValueAt(ValueKind.COSTATE, i) for i in terms.solved_costates()}
    known: dict[int, ca.SX] = {}
    for i, (label, expr) in guards.items():
        own = {at.index: s for at, s in _read(locator, label, expr).items() if at.kind is ValueKind.STATE}
        states = sorted(own)
        slope = ca.jacobian(expr, ca.vertcat(ca.SX(0, 1), *(own[j] for j in states)))
        rate = ca.mtimes(slope, ca.vertcat(ca.SX(0, 1), *(f[j] for j in states))) + ca.jacobian(expr, time)
        moved = {states[c] for c in slope.sparsity().get_triplet()[1]}
        if not (moved & unknown or _read(locator, label, rate).keys() & hidden):
            known[i] = ca.densify(rate)
    rates = at_instant(terms, [(guards[i][0], rate) for i, rate in known.items()])
    return {
        i: (guards[i][0], rate)
        for i, rate in zip(known, rates, strict=True)
        if not rate.is_constant()
        and all(
            at.kind is not ValueKind.ALGEBRAIC for e in (guards[i][1], rate) for at in _read(locator, guards[i][0], e)
        )
    }


def _read(locator: Locator, label: str, expr: ca.SX) -> dict[ValueAt, ca.SX]:
    """The symbols of an expression by their places."""
    return {locator.find(s, label): s for s in ca.symvar(expr)}


def _spec(term: Term) -> Spec:
    x = ca.vertcat(term.symbols(ValueKind.STATE), term.symbols(ValueKind.TIME))
    y = [(Address(READ[k], j), s) for k in (ValueKind.ALGEBRAIC, ValueKind.INPUT) for j, s in enumerate(_each(term, k))]
    return Spec(1, x, term.symbols(ValueKind.PARAMETER), y, [(Address(row), 0, term.data["f"])], report=True)


def _each(term: Term, kind: ValueKind) -> list[ca.SX]:
    """Local symbols of a kind, one by one."""
    return ca.vertsplit(term.symbols(kind)) if term.indices(kind) else []


def _table(terms: Terms, spec: Spec, own: list[Term]) -> Group:
    """The group of the guards `own`, which share a kernel."""
    x = [[*t.indices(ValueKind.STATE), *(terms.n1 for _ in t.indices(ValueKind.TIME))] for t in own]
    y = [[*t.indices(ValueKind.ALGEBRAIC), *(terms.na + u for u in t.indices(ValueKind.INPUT))] for t in own]
    rows = x, y, [t.indices(ValueKind.PARAMETER) for t in own], [[t.rows[0].index] for t in own]
    arrays = [np.array(r, np.int32).reshape(len(own), -1) for r in rows]
    return Group(build(spec), 1, 1, *arrays, power=np.zeros(1, np.int8), owner=np.zeros(len(own), np.int32))


def at_instant(terms: Terms, labelled: Sequence[tuple[str, ca.SX]]) -> list[ca.SX]:
    """Expressions with labels: costates become functions of the states, inputs fed from inside become their sources."""
    if not labelled:
        return []
    exprs = [expr for _, expr in labelled]
    model, z = terms.model, costate_symbols(terms.model)
    solved = terms.solved_costates()
    if solved and ca.depends_on(ca.vertcat(*map(ca.vec, exprs)), ca.vertcat(*(z[i] for i in solved))):
        label, i = next((n, i) for n, e in labelled for i in solved if ca.depends_on(e, z[i]))
        raise DeclarationError(
            f"{model.name}: {label}", f"reads the costate of {terms.state_names[i]}, whose E is no constant diagonal",
            "write it as a function of the states", "symbol",
        )  # fmt: skip
    fed = [p for p in terms.pairs if not p.port.external]
    inside = [ca.SX(p.port.bound[p.j] if p.port.bound is not None else ca.SX(_sx(p.port.source))[p.j]) for p in fed]
    return ca.substitute(exprs, [z, *(p.port.u[p.j] for p in fed)], [costates(terms), *inside])
