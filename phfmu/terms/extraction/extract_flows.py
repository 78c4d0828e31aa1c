"""Extraction of the flows: blocks of J and R, ports and their sources, as terms and constant entries."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca

from phfmu.declare.block import Block
from phfmu.declare.entries.coefficients import coefficient
from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.declare.variable import ValueKind, Variable, VariableKind, _sx
from phfmu.terms.canonical import Locator, alike, components, make_term, scalars
from phfmu.terms.located import EFFORT_OF, ROW_OF, Constant, Row, RowAt, ValueAt
from phfmu.terms.term import FLOW, SOURCE, Term, Terms


def _rows(
    model: PHDAE, variables: Sequence[Variable | Port], locator: Locator
) -> tuple[list[RowAt], list[ValueAt | None]]:
    """Rows of `variables`, and where the effort of each is a plain value (None: a given z2).

    A port has the rows -y of its pairs, and its input is the effort.
    """
    found = [at for v in variables for at in locator.of(v)]
    if not {at.kind for at in found} <= ROW_OF.keys():
        raise DeclarationError(
            f"{model.name}: block on {', '.join(v.name for v in variables)}",
            "blocks of J and R act on states, algebraic variables and ports only",
            "list one of these instead",
            "symbol",
        )
    rows = [RowAt(ROW_OF[at.kind], at.index) for at in found]
    plain = [v.kind is not VariableKind.ALGEBRAIC or v not in model.z for v in variables for _ in range(v.n)]
    sources = [ValueAt(EFFORT_OF[row.kind], row.index) if ok else None for row, ok in zip(rows, plain, strict=True)]
    return rows, sources


def _constant(entry: ca.SX | float) -> float | None:
    return float(entry) if not isinstance(entry, ca.SX) or entry.is_constant() else None


def _targets(out: Terms, row: RowAt) -> list[tuple[RowAt, float]]:
    """Rows that an entry of a block adds to, with signs: -y is also booked where a bound port is fed from."""
    if row.kind is not Row.OUTPUT:
        return [(row, 1.0)]
    back = out.bound.get(row.index)
    return [(row, -1.0)] if back is None else [(row, -1.0), (RowAt(Row.EQUATION, back), 1.0)]


def _flow(out: Terms, rows: Sequence[RowAt], f: ca.SX) -> tuple[list[RowAt], ca.SX]:
    """Rows and values of a block's product f = (J - R) z."""
    found = [(target, sign * f[j]) for j, row in enumerate(rows) for target, sign in _targets(out, row)]
    return [target for target, _ in found], ca.vertcat(*(value for _, value in found))


@dataclass(frozen=True, eq=False)
class _LabelledBlock:
    """A block with its variables, their rows, and where the effort of each row is a plain value."""

    model: PHDAE
    block: Block
    rows: list[RowAt]
    sources: list[ValueAt | None]
    owner: int
    label: str

    @cached_property
    def z(self) -> ca.SX:
        """The efforts."""
        return ca.vertcat(*(self.model.effort(v) for v in self.block.variables))

    def terms(self, out: Terms, locator: Locator, parts: list[ca.SX], make: Callable[[], list[Term]]) -> list[Term]:
        """Terms that follow from expressions `parts` of this block, made once for all blocks that are alike."""
        rows = [target for row in self.rows for target, _ in _targets(out, row)]
        bound = tuple(row.index in out.bound for row in self.rows if row.kind is Row.OUTPUT)
        return alike([*parts, self.z], rows, locator, self.label, make, self.owner, bound)


def blocks(model: PHDAE, out: Terms, locator: Locator) -> None:
    """Terms and constant entries of J and R."""
    for b in model.structure:
        _interconnection(out, locator, _labelled(model, out, locator, b, "J"))
    for b in model.dissipation:
        _dissipation(out, locator, _labelled(model, out, locator, b, "R"))


def _labelled(model: PHDAE, out: Terms, locator: Locator, b: Block, what: str) -> _LabelledBlock:
    rows, sources = _rows(model, b.variables, locator)
    label = f"{what} block on {', '.join(v.name for v in b.variables)}"
    shape = b.matrix.shape if b.factor is None else (b.n, b.n)
    if shape != (len(rows), len(rows)):
        raise DeclarationError(
            label,
            f"is {shape[0]} x {shape[1]}, expected {len(rows)} square",
            "make it as large as its variables and ports",
            "shape",
        )
    return _LabelledBlock(model, b, rows, sources, out.member(b.owner), label)


def _dissipation(out: Terms, locator: Locator, b: _LabelledBlock) -> None:
    own = _shortest(b.block)

    def dissipation() -> list[Term]:
        found = []
        for part in _sharing(own, locator):
            f, loss = _dissipated(own, part, ca.vertcat(*(b.z[i] for i in part)))
            where, values = _flow(out, [b.rows[i] for i in part], f)
            exprs = {"f": values, "loss": loss}
            found.append(make_term(FLOW, exprs, locator, b.label, rows=where, owner=b.owner))
        return found

    out.terms += b.terms(out, locator, own.parts, dissipation)


def _shortest(b: Block) -> Block:
    """The block by its entries, where it has no more of them than its factors, both that and its transpose."""
    if b.factor is None or b.pattern.nnz() > b.value.nnz() + 2 * b.factor.nnz():
        return b
    return Block(b.variables, b.matrix, b.owner)


def _dissipated(b: Block, part: list[int], z: ca.SX) -> tuple[ca.SX, ca.SX]:
    """f = -R z and the power z^T R z of the rows `part`, of a block with a factor by the rates G z."""
    if b.factor is None:
        f = -ca.mtimes(b.value[part, part], z)
        return f, -ca.dot(z, f)
    g = b.factor[:, part]
    rates = ca.mtimes(g, z)
    forces = ca.mtimes(b.value, rates)
    return -ca.mtimes(g.T, forces), ca.dot(rates, forces)


def _sharing(b: Block, locator: Locator) -> list[list[int]]:
    """Components of a block; those that depend on the same states are one, which evaluates their common part once."""
    merged: dict[tuple, list[int]] = {}
    for i, part in enumerate(components(b.pattern)):
        symbols = ca.symvar(ca.veccat(*b.on(part).parts))
        found = ((s, locator.find(s, "a block of R")) for s in symbols)
        states = tuple(sorted(s.element_hash() for s, at in found if at.kind is ValueKind.STATE))
        merged.setdefault(states or (i,), []).extend(part)
    return [sorted(part) for part in merged.values()]


def _interconnection(out: Terms, locator: Locator, b: _LabelledBlock) -> None:
    varying: list[tuple[int, int, ca.SX]] = []
    i_row, i_col = b.block.matrix.sparsity().get_triplet()
    entries = scalars(b.block.matrix)
    values = [_constant(entry) for entry in entries]
    for r, c, entry, value in zip(i_row, i_col, entries, values, strict=True):
        source = b.sources[c]
        if value is None or (source is None and value):
            varying.append((r, c, entry))
        elif value and source is not None:
            out.constants += [Constant(target, source, sign * value) for target, sign in _targets(out, b.rows[r])]
    if not varying:
        return
    i_row, i_col, entries = (list(column) for column in zip(*varying, strict=True))
    matrix = ca.SX.triplet(i_row, i_col, ca.vertcat(*entries), *b.block.matrix.shape)

    def interconnection() -> list[Term]:
        found = []
        for part in components(matrix):
            zp = ca.vertcat(*(b.z[i] for i in part))
            where, f = _flow(out, [b.rows[i] for i in part], ca.mtimes(matrix[part, part], zp))
            found.append(make_term(FLOW, {"f": f}, locator, b.label, rows=where, owner=b.owner))
        return found

    out.terms += b.terms(out, locator, [matrix], interconnection)


def ports(out: Terms, locator: Locator) -> None:
    """Terms and constant entries of B, and terms of sources."""
    first: dict[int, int] = {}
    for i, pair in enumerate(out.pairs):
        first.setdefault(id(pair.port), i)
    for port in dict.fromkeys(p.port for p in out.pairs):
        _port(out, locator, port, first[id(port)])
        if port.source is not None:
            s = ca.SX(_sx(port.source))
            where = {str(x): locator.find(x, f"source of '{port.name}'") for x in ca.symvar(s)}
            other = [x for x, at in where.items() if at.kind not in (ValueKind.TIME, ValueKind.PARAMETER)]
            if other:
                raise DeclarationError(
                    f"source of '{port.name}'", f"depends on {', '.join(other)}", "a source may depend on time and "
                    "parameters only", "source",
                )  # fmt: skip
            for j in range(port.n):
                i = first[id(port)] + j
                rows = [RowAt(Row.SOURCE, i)]
                out.terms.append(make_term(SOURCE, {"s": s[j]}, locator, f"source of '{port.name}'", rows=rows))


def _entries(port: Port, v: Variable, value: Any) -> list[tuple[int, int, ca.SX | float]]:
    """(row, column, entry) of the columns of B on a variable that are not zero by their structure."""
    if isinstance(value, int | float) and v.n == port.n:  # that multiple of the identity, as most are
        return [(j, j, float(value)) for j in range(v.n)]
    b = coefficient(value, v.n, port.n)
    if b.shape != (v.n, port.n):
        raise DeclarationError(
            f"port '{port.name}'", f"B on '{v.name}' is {b.shape[0]} x {b.shape[1]}, expected {v.n} x {port.n}",
            "make it as large as the variable and the port", "shape",
        )  # fmt: skip
    return list(zip(*b.sparsity().get_triplet(), scalars(b), strict=True))


def _port(out: Terms, locator: Locator, port: Port, first: int) -> None:
    varying: dict[RowAt, ca.SX] = {}
    for v, given in port.on.items():
        entries = _entries(port, v, given)
        rows, sources = _rows(out.model, [v], locator)
        for r, j, entry in entries:
            pair, row, source, value = first + j, rows[r], sources[r], _constant(entry)
            back = RowAt(Row.EQUATION, out.bound[pair]) if pair in out.bound else None
            if value == 0.0:
                continue
            targets: list[tuple[RowAt, ca.SX]] = []
            if value is not None:
                out.constants.append(Constant(row, ValueAt(ValueKind.INPUT, pair), value))
            else:
                targets.append((row, entry * port.u[j]))
            if value is not None and source is not None:
                out.constants.append(Constant(RowAt(Row.OUTPUT, pair), source, value))
                if back:
                    out.constants.append(Constant(back, source, -value))
            else:
                y = entry * out.model.effort(v)[r]
                targets += [(RowAt(Row.OUTPUT, pair), y)] + ([(back, -y)] if back else [])
            for target, expr in targets:
                varying[target] = varying.get(target, ca.SX(0)) + expr
    if varying:
        f = ca.vertcat(*varying.values())
        out.terms.append(make_term(FLOW, {"f": f}, locator, f"port '{port.name}'", rows=list(varying)))
