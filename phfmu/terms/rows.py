"""Algebraic rows as expressions of a model's own symbols."""

from __future__ import annotations

from collections.abc import Iterable

import casadi as ca

from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import ValueKind, time
from phfmu.terms.extraction.extract_energy import all_divided
from phfmu.terms.hidden import Check, HiddenConstraints, Level
from phfmu.terms.located import Row
from phfmu.terms.term import CLOSED, CONSTRAINT, FLOW, MASS, Term, Terms, by_kind, gathered
from phfmu.terms.velocities import velocity_of


def costate_symbols(model: PHDAE) -> ca.SX:
    """The symbols z of all states, stacked."""
    return ca.vertcat(*(v.z for v in model.states))


def row_expressions(terms: Terms, rows: Iterable[int], z: ca.SX, u: ca.SX | None = None) -> dict[int, ca.SX]:
    """The chosen algebraic rows [(J - R) z + B u]_2 in x, `z` (n1), algebraic variables and parameters.

    `u`: free inputs (a symbol a pair), by default left out;  the rows of holonomic constraints are without these.
    """
    return _expressions(terms, Row.EQUATION, rows, z, ca.SX.zeros(len(terms.pairs)) if u is None else u)


def output_expressions(terms: Terms, pairs: Iterable[int], z: ca.SX, u: ca.SX) -> dict[int, ca.SX]:
    """The chosen pair outputs y = B^T z in x, `z` (n1), algebraic variables, parameters and free inputs `u` (a symbol a pair)."""
    return _expressions(terms, Row.OUTPUT, pairs, z, u)


def flow_expressions(terms: Terms, z: ca.SX, u: ca.SX) -> tuple[ca.SX, ca.SX]:
    """All rows [(J - R) z + B u] of the states and of the algebraic variables, without forces of holonomic constraints.

    In x, `z` (n1), algebraic variables, parameters and `u` (an expression a pair that is not fed by an algebraic variable).
    """
    flows = _expressions(terms, Row.BALANCE, range(terms.n1), z, u)
    rows = _expressions(terms, Row.EQUATION, range(terms.na), z, u)
    return tuple(ca.vertcat(ca.SX(0, 1), *(f[i] for i in range(len(f)))) for f in (flows, rows))  # type: ignore[return-value]


def _expressions(terms: Terms, kind: Row, rows: Iterable[int], z: ca.SX, u: ca.SX) -> dict[int, ca.SX]:
    """The chosen rows of one kind; `u`: expressions of the free inputs."""
    model, bound, x = terms.model, terms.bound, terms.model.x
    found = {r: ca.SX(0) for r in rows}
    p = ca.vertcat(*(v.sx for v in model.parameters))
    a = ca.vertcat(*(v.sx for v in model.algebraics))
    read = {
        ValueKind.COSTATE: z.__getitem__,
        ValueKind.ALGEBRAIC: a.__getitem__,
        ValueKind.INPUT: lambda i: _input(i, u, a, bound),
    }
    for c in terms.constants:
        if c.row.kind is kind and c.row.index in found:
            found[c.row.index] += c.value * read[c.source.kind](c.source.index)
    for t in terms.of(FLOW):
        chosen = [(j, r.index) for j, r in enumerate(t.rows) if r.kind is kind and r.index in found]
        if chosen:
            f = ca.substitute([t.data["f"]], *_globals(t, x, z, p, a, bound, u))[0]
            for j, i in chosen:
                found[i] += f[j]
    return found


def _input(i: int, u: ca.SX, a: ca.SX, bound: dict[int, int]) -> ca.SX:
    """Input of a pair: the algebraic variable that feeds it, or its entry of `u`."""
    return a[bound[i]] if i in bound else u[i]


def check_rows(terms: Terms, checks: list[Check], z: ca.SX | None = None) -> list[ca.SX]:
    """The undifferentiated hidden rows as expressions of the model's own symbols (inputs left out).

    Algebraic variables that over-determined rows give (the common velocity of a rigid joint) are eliminated.
    z: what stands for the costates (default: they as functions of the states).
    """
    model, hidden, x = terms.model, terms.found(HiddenConstraints), terms.model.x
    z = costates(terms) if z is None else z
    p = ca.vertcat(*(v.sx for v in model.parameters))
    a = ca.vertcat(*(v.sx for v in model.algebraics))
    position = {c.row: n for n, c in enumerate(checks) if c.level is Level.POSITION}
    rows = row_expressions(terms, hidden.rows, z)
    out, velocity = [ca.SX(0) for _ in checks], velocity_of(terms)
    for own in by_kind(terms.of(CONSTRAINT)):
        first = own[0]
        g, q, t = first.data["g"], first.local[ValueKind.STATE], first.symbols(ValueKind.TIME)
        v, moving = ca.SX.sym("v", q.numel()), ca.gradient(g, t) if t.numel() else ca.SX(0)
        local = [q, v, first.symbols(ValueKind.PARAMETER), t]
        f = ca.Function("g", local, [ca.densify(g), ca.densify(ca.dot(ca.gradient(g, q), v) + moving)])
        at = ca.SX(z[[velocity[i] for c in own for i in c.index[ValueKind.STATE]]])
        given = [
            gathered(x, own, ValueKind.STATE),
            ca.reshape(at, q.numel(), len(own)),
            gathered(p, own, ValueKind.PARAMETER),
        ]
        positions, velocities = f.call([*given, ca.repmat(time, t.numel(), len(own))])
        for c, value, rate in zip(own, ca.horzsplit(positions), ca.horzsplit(velocities), strict=True):
            rows[c.rows[0].index] += rate
            if c.rows[0].index in position:
                out[position[c.rows[0].index]] += value
    eliminated = _eliminated(rows, hidden, a)
    for n, c in enumerate(checks):
        if c.level is Level.VELOCITY:
            out[n] = eliminated[c.row]
    return out


def _eliminated(rows: dict[int, ca.SX], hidden: HiddenConstraints, a: ca.SX) -> dict[int, ca.SX]:
    """The check rows with the algebraic variables replaced by the solutions of their own (linear) rows."""
    if not hidden.solved_by:
        return rows
    own = ca.vertcat(*(rows[r] for r in hidden.solved_by))
    variables = ca.vertcat(*(a[i] for i in hidden.solved_by.values()))
    zero = ca.SX.zeros(variables.numel(), 1)
    at_zero, matrix = ca.substitute([own, ca.jacobian(own, variables)], [variables], [zero])
    value = -ca.solve(matrix, at_zero)
    checks = hidden.checks
    new = ca.substitute([rows[r] for r in checks], [variables], [value]) if checks else []
    return dict(zip(checks, new, strict=True))


def costates(terms: Terms) -> ca.SX:
    """z = E^-T grad H for diagonal E and closed-form pairs."""
    model = terms.model
    z = ca.densify(ca.gradient(model.hamiltonian, model.x)) if terms.n1 else ca.SX(0, 1)
    p = ca.vertcat(*(v.sx for v in model.parameters))
    where, masses = [], []
    for t in terms.of(MASS):
        local, m = t.symbols(ValueKind.PARAMETER), t.data["m"]
        if local.numel():
            own = p[list(t.index[ValueKind.PARAMETER])]
            m = own if m.is_symbolic() else ca.substitute([m], [local], [own])[0]
        where.append(t.rows[0].index)
        masses.append(m)
    if where:
        z[where] = ca.vertcat(*all_divided(z[where], masses))
    for t in terms.of(CLOSED):
        value = ca.substitute([t.data["z"]], *_globals(t, model.x, z, p, ca.SX(0, 1), {}))[0]
        for j, r in enumerate(t.rows):
            z[r.index] = value[j]
    return z


def block_matrix(terms: Terms, t: Term) -> ca.SX:
    """E of a mass block in the model's own symbols."""
    model = terms.model
    p = ca.vertcat(*(v.sx for v in model.parameters))
    return ca.substitute([t.data["E"]], *_globals(t, model.x, costate_symbols(model), p, ca.SX(0, 1), {}))[0]


def _globals(
    t: Term, x: ca.SX, z: ca.SX, p: ca.SX, a: ca.SX, bound: dict[int, int], u: ca.SX | None = None
) -> tuple[list[ca.SX], list[ca.SX]]:
    """Old and new symbols that bring a local expression back to the model's; free inputs become those of `u`, or 0."""
    old, new = [], []
    for kind, source in (
        (ValueKind.STATE, x),
        (ValueKind.COSTATE, z),
        (ValueKind.PARAMETER, p),
        (ValueKind.ALGEBRAIC, a),
    ):
        if kind in t.local:
            old.append(t.local[kind])
            new.append(source[list(t.index[kind])])
    if ValueKind.TIME in t.local:
        old.append(t.local[ValueKind.TIME])
        new.append(time)
    if ValueKind.INPUT in t.local:
        old.append(t.local[ValueKind.INPUT])
        free = ca.SX.zeros(1 + max(t.index[ValueKind.INPUT])) if u is None else u
        new.append(ca.vertcat(*(_input(i, free, a, bound) for i in t.index[ValueKind.INPUT])))
    return old, new
