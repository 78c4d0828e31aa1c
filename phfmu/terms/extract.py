"""Extraction: walk a declaration once and list its terms and constant triplets."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from phfmu.declare.dense import coefficient, square, stacked
from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE, Block
from phfmu.declare.port import Port
from phfmu.declare.regular import undetermined
from phfmu.declare.variable import Variable, _sx
from phfmu.terms.extract_constraints import constraints
from phfmu.terms.extract_energy import energies
from phfmu.terms.hidden import hidden_rows
from phfmu.terms.term import (
    CLOSED,
    FLOW,
    MASS,
    MASS_BLOCK,
    OBSERVABLE,
    SOURCE,
    Locator,
    Pair,
    Terms,
    WithIncrement,
    components,
    make_term,
    member,
    scalars,
)


def extract(model: PHDAE, *, joint: bool = False) -> Terms:
    """All terms of `model`; `joint` merges the energies of each member into one term (joint Gonzalez gradient)."""
    members = list(model.members)
    free = [p for p in model.ports if p.external]
    rest = [p for p in model.ports if not p.external]
    pairs = [Pair(p, j, member(members, p.owner)) for p in (*free, *rest) for j in range(p.n)]
    out = Terms(
        model,
        n1=sum(v.n for v in model.states),
        na=sum(v.n for v in model.algebraics),
        np=sum(v.n for v in model.parameters),
        pairs=pairs,
        nu=sum(p.n for p in free),
        members=members,
    )
    locator = Locator(model, pairs)
    for i, pair in enumerate(pairs):
        if pair.port.bound is not None:
            out.bound[i] = locator.find(pair.port.bound[pair.j], pair.port.name)[1]
    mass = _masses(model, out, locator)
    _closed(model, out, locator)
    _blocks(model, out, locator)
    _ports(out, locator)
    constraints(model, out, locator)
    energies(model, out, locator, mass, joint)
    row = 0
    for o in model.observables:
        n = o.expr.numel()
        rows = [("o", row + j) for j in range(n)]
        out.observable_names += [o.name] if n == 1 else [f"{o.name}[{j + 1}]" for j in range(n)]
        out.terms.append(make_term(OBSERVABLE, {"f": ca.vec(o.expr)}, locator, f"observable '{o.name}'", rows=rows))
        row += n
    out.hidden = hidden_rows(out)
    return out


def _masses(model: PHDAE, out: Terms, locator: Locator) -> dict[int, ca.SX]:
    """Rows of E other than identity; returns the diagonal entries, state index -> expression."""
    diagonal: dict[int, ca.SX] = {}
    solved: list[int] = []
    for key, value in model.E.items():
        variables = stacked(key)
        label = f"E of {', '.join(repr(v.name) for v in variables)}"
        if any(v.role != "state" for v in variables):
            raise DeclarationError(
                label,
                "E acts on states; an algebraic variable has zero rows of E",
                "leave it out of E, or make it a state",
                "symbol",
            )
        where = [i for v in variables for _, i in locator.of(v)]
        x, z = ca.vertcat(*(v.sx for v in variables)), ca.vertcat(*(v.z for v in variables))
        n = x.numel()
        matrix = square(value, n)
        if matrix.shape != (n, n):
            raise DeclarationError(
                label,
                f"is {matrix.shape[0]} x {matrix.shape[1]}, expected {n} x {n}",
                "make it as large as its variables",
                "shape",
            )
        kinds = {locator.find(s, label)[0] for s in ca.symvar(matrix)}
        if matrix.sparsity().is_diag() and kinds <= {"p"}:
            for i, m, s in zip(where, scalars(matrix), ca.vertsplit(x), strict=True):
                diagonal[i] = m
                out.terms.append(make_term(MASS, {"m": m}, locator, label, rows=[("x", i)], extra=[s]))
        else:
            if kinds <= {"p"}:
                _require_regular(label, model, matrix)
            solved += where
            exprs = {"E": matrix, "z": z}
            out.terms.append(
                make_term(MASS_BLOCK, exprs, locator, label, rows=[("x", i) for i in where],
                          extra=[*ca.vertsplit(x), *ca.vertsplit(z)])
            )  # fmt: skip
    out.solved_costates = tuple(solved)
    return diagonal


def _require_regular(label: str, model: PHDAE, matrix: ca.SX) -> None:
    p = ca.vertcat(ca.SX(0, 1), *(q.sx for q in model.parameters))
    value = ca.Function("E", [p], [ca.densify(matrix)])([s for q in model.parameters for s in q.start])
    if undetermined(np.array(value)) >= 0:
        raise DeclarationError(
            f"{model.name}: {label}",
            "is singular, so z and the rates do not follow from it",
            "give z of its variables and use reduce_descriptor(model)",
            "descriptor",
        )


def _closed(model: PHDAE, out: Terms, locator: Locator) -> None:
    for pair in model.closed:
        x = ca.vertcat(*(v.sx for v in pair.variables))
        d = ca.SX.sym("d", x.numel())
        where = [i for v in pair.variables for _, i in locator.of(v)]
        out.closed_states.update(where)
        exprs = {"H": pair.hamiltonian, "E": pair.E, "z": pair.z}
        # d is no model symbol: it enters through a second locator that maps it onto inputs of the kernel
        if pair.ebar is not None and pair.zbar is not None:
            exprs |= {"ebar": pair.ebar(x, d), "zbar": pair.zbar(x, d)}
        probe = Locator(model, out.pairs)
        for j in range(d.numel()):
            probe.where[d[j].element_hash()] = ("d", where[j])
        term = make_term(CLOSED, exprs, WithIncrement(probe), "closed-form pair",
                         rows=[("x", i) for i in where], owner=member(out.members, pair.owner),
                         extra=[*ca.vertsplit(x), *ca.vertsplit(d)])  # fmt: skip
        out.terms.append(term)


def _rows(
    model: PHDAE, variables: Sequence[Variable | Port], locator: Locator
) -> tuple[list[tuple[str, int]], ca.SX, list[tuple[str, int] | None]]:
    """Rows of `variables`, their efforts, and where each effort is a plain value (None: a given z2).

    A port has the rows -y of its pairs, and its input is the effort.
    """
    rows = [("y", i) if kind == "u" else (kind, i) for v in variables for kind, i in locator.of(v)]
    for kind, _ in rows:
        if kind not in ("x", "a", "y"):
            raise DeclarationError(
                f"{model.name}: block on {', '.join(v.name for v in variables)}",
                "blocks of J and R act on states, algebraic variables and ports only",
                "list one of these instead",
                "symbol",
            )
    plain = [v.role != "algebraic" or v not in model.z for v in variables for _ in range(v.n)]
    sources = [_source(row) if ok else None for row, ok in zip(rows, plain, strict=True)]
    return rows, ca.vertcat(*(model.effort(v) for v in variables)), sources


def _constant(entry: ca.SX) -> float | None:
    return float(entry) if entry.is_constant() else None


def _source(row: tuple[str, int]) -> tuple[str, int]:
    return ({"x": "z", "y": "u"}.get(row[0], row[0]), row[1])


def _targets(out: Terms, row: tuple[str, int]) -> list[tuple[tuple[str, int], float]]:
    """Rows that an entry of a block adds to, with signs: -y is also booked where a bound port is fed from."""
    if row[0] != "y":
        return [(row, 1.0)]
    back = out.bound.get(row[1])
    return [(row, -1.0)] if back is None else [(row, -1.0), (("a", back), 1.0)]


def _flow(out: Terms, rows: Sequence[tuple[str, int]], f: ca.SX) -> tuple[list[tuple[str, int]], ca.SX]:
    """Rows and values of a block's product f = (J - R) z."""
    found = [(target, sign * f[j]) for j, row in enumerate(rows) for target, sign in _targets(out, row)]
    return [target for target, _ in found], ca.vertcat(*(value for _, value in found))


def _blocks(model: PHDAE, out: Terms, locator: Locator) -> None:
    for what, blocks in (("J", model.structure), ("R", model.dissipation)):
        for b in blocks:
            rows, z, sources = _rows(model, b.variables, locator)
            label = f"{what} block on {', '.join(v.name for v in b.variables)}"
            if b.matrix.shape != (len(rows), len(rows)):
                raise DeclarationError(
                    label,
                    f"is {b.matrix.shape[0]} x {b.matrix.shape[1]}, expected {len(rows)} square",
                    "make it as large as its variables and ports",
                    "shape",
                )
            owner = member(out.members, b.owner)
            if what == "R":
                _dissipation(out, locator, b, rows, z, owner, label)
            else:
                _interconnection(out, locator, b, rows, z, sources, owner, label)


def _dissipation(out: Terms, locator: Locator, b: Block, rows: list, z: ca.SX, owner: int, label: str) -> None:
    for part in _sharing(b.matrix, locator):
        zp = ca.vertcat(*(z[i] for i in part))
        f = -ca.mtimes(b.matrix[part, part], zp)
        where, values = _flow(out, [rows[i] for i in part], f)
        exprs = {"f": values, "loss": -ca.dot(zp, f)}
        out.terms.append(make_term(FLOW, exprs, locator, label, rows=where, owner=owner))


def _sharing(matrix: ca.SX, locator: Locator) -> list[list[int]]:
    """Components of a matrix; those that depend on the same states are one, which evaluates what they share once."""
    merged: dict[tuple, list[int]] = {}
    for i, part in enumerate(components(matrix)):
        symbols = ca.symvar(ca.vec(matrix[part, part]))
        states = tuple(sorted(s.element_hash() for s in symbols if locator.find(s, "a block of R")[0] == "x"))
        merged.setdefault(states or (i,), []).extend(part)
    return [sorted(part) for part in merged.values()]


def _interconnection(
    out: Terms,
    locator: Locator,
    b: Block,
    rows: list[tuple[str, int]],
    z: ca.SX,
    sources: list[tuple[str, int] | None],
    owner: int,
    label: str,
) -> None:
    varying: list[tuple[int, int, ca.SX]] = []
    i_row, i_col = b.matrix.sparsity().get_triplet()
    for r, c, entry in zip(i_row, i_col, scalars(b.matrix), strict=True):
        value, source = _constant(entry), sources[c]
        if value is None or (source is None and value):
            varying.append((r, c, entry))
        elif value and source is not None:
            out.constants += [(*target, *source, sign * value) for target, sign in _targets(out, rows[r])]
    if not varying:
        return
    i_row, i_col, entries = (list(column) for column in zip(*varying, strict=True))
    matrix = ca.SX.triplet(i_row, i_col, ca.vertcat(*entries), *b.matrix.shape)
    for part in components(matrix):
        zp = ca.vertcat(*(z[i] for i in part))
        where, f = _flow(out, [rows[i] for i in part], ca.mtimes(matrix[part, part], zp))
        out.terms.append(make_term(FLOW, {"f": f}, locator, label, rows=where, owner=owner))


def _ports(out: Terms, locator: Locator) -> None:
    first: dict[int, int] = {}
    for i, pair in enumerate(out.pairs):
        first.setdefault(id(pair.port), i)
    for port in dict.fromkeys(p.port for p in out.pairs):
        _port(out, locator, port, first[id(port)])
        if port.source is not None:
            s = ca.SX(_sx(port.source))
            other = [str(x) for x in ca.symvar(s) if locator.find(x, f"source of '{port.name}'")[0] not in ("t", "p")]
            if other:
                raise DeclarationError(
                    f"source of '{port.name}'", f"depends on {', '.join(other)}", "a source may depend on time and "
                    "parameters only", "source",
                )  # fmt: skip
            for j in range(port.n):
                i = first[id(port)] + j
                out.terms.append(make_term(SOURCE, {"s": s[j]}, locator, f"source of '{port.name}'", rows=[("u", i)]))


def _port(out: Terms, locator: Locator, port: Port, first: int) -> None:
    varying_f: dict[tuple[str, int], ca.SX] = {}
    for v, value in port.on.items():
        b = coefficient(value, v.n, port.n)
        if b.shape != (v.n, port.n):
            raise DeclarationError(
                f"port '{port.name}'", f"B on '{v.name}' is {b.shape[0]} x {b.shape[1]}, expected {v.n} x {port.n}",
                "make it as large as the variable and the port", "shape",
            )  # fmt: skip
        rows, z, sources = _rows(out.model, [v], locator)
        i_row, i_col = b.sparsity().get_triplet()
        for r, j in zip(i_row, i_col, strict=True):
            pair = first + j
            back = None if port.bound is None else locator.find(port.bound[j], f"port '{port.name}'")
            value = _constant(b[r, j])
            if value == 0.0:
                continue
            targets: list[tuple[tuple[str, int], ca.SX]] = []
            if value is not None:
                out.constants.append((*rows[r], "u", pair, value))
            else:
                targets.append((rows[r], b[r, j] * port.u[j]))
            source = sources[r]
            if value is not None and source is not None:
                out.constants.append(("y", pair, *source, value))
                if back:
                    out.constants.append((*back, *source, -value))
            else:
                y = b[r, j] * z[r]
                targets += [(("y", pair), y)] + ([(back, -y)] if back else [])
            for target, expr in targets:
                varying_f[target] = varying_f.get(target, ca.SX(0)) + expr
    if varying_f:
        f = ca.vertcat(*varying_f.values())
        out.terms.append(make_term(FLOW, {"f": f}, locator, f"port '{port.name}'", rows=list(varying_f)))
