"""Rules on equations: variables and ports occur, constraints act on velocities, the system can be solved.

Warnings: constraints that a source moves, which steps meet at their nodes only.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import casadi as ca
import numpy as np

from phfmu.declare.entries.entries import Entries, key
from phfmu.declare.entries.entry_kind import EntryKind
from phfmu.declare.error import DeclarationError, Problem
from phfmu.declare.junction_words import junction_words
from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import ValueKind, _sx, time
from phfmu.discretise.model import CONSISTENCY, Model, build_model
from phfmu.engine.reference.python import PythonInstance
from phfmu.outcome.status import Status, StepFailure, remedy
from phfmu.schemes.scheme import Scheme
from phfmu.terms.canonical import components
from phfmu.terms.extraction.extract import extract
from phfmu.terms.hidden import HiddenConstraints, Level
from phfmu.terms.rows import costate_symbols, flow_expressions
from phfmu.terms.term import CONSTRAINT


def unused(entries: Entries) -> list[Problem]:
    """Every algebraic variable occurs in an equation, every port acts on one."""
    seen = set(entries.doubtful)

    def see(expr: ca.SX) -> None:
        seen.update(s.element_hash() for s in ca.symvar(ca.sparsify(expr)))

    for e in entries.of(EntryKind.J, EntryKind.R):
        see(ca.mtimes(ca.sparsify(e.expr), ca.vertcat(*(entries.model.effort(v) for v in e.rows))))
    for e in entries.of(EntryKind.B):
        see(e.expr)
        if e.origin.bound is not None:
            see(ca.mtimes(ca.sparsify(e.expr).T, entries.model.effort(e.rows[0])))
    for e in entries.of(EntryKind.BOUND):
        see(e.expr)
    for e in entries.of(EntryKind.CONSTRAINT):
        seen.update(s.element_hash() for s in ca.vertsplit(e.rows[0].sx))
    found = []
    for v in entries.model.algebraics:
        for name, s in zip(v.names(), ca.vertsplit(v.sx), strict=True):
            if s.element_hash() not in seen:
                text, remedy = "appears in no equation", "couple it by a block of J or R, or leave it out"
                found.append(Problem("unused", f"algebraic variable '{name}'", text, remedy))
    return found + _idle_ports(entries)


def _idle_ports(entries: Entries) -> list[Problem]:
    """Every port acts on something; ports with a B that was left out are not judged."""
    sound = entries.of(EntryKind.B)
    acting = {key(e.origin) for e in sound if ca.sparsify(e.expr).nnz()}
    acting |= {key(v) for e in entries.of(EntryKind.J, EntryKind.R) for v in e.rows if ca.sparsify(e.expr).nnz()}
    judged = Counter(id(e.origin) for e in sound)
    drives = {c.drive.u[0].element_hash() for c in entries.model.constraints if c.drive is not None}
    return [
        Problem(
            "unused",
            f"port '{p.name}'",
            "B is zero: the port acts on no equation",
            "give `on` its variables, or a block of J or R the port",
        )
        for p in entries.model.ports
        if key(p) not in acting and judged[id(p)] == len(p.on) and p.u[0].element_hash() not in drives
    ]


def velocities(entries: Entries) -> list[Problem]:
    """Every position q of a constraint g(q) = 0 has the equation q' = z_v."""
    constraints = entries.of(EntryKind.CONSTRAINT)
    if not constraints:
        return []
    row: dict[int, ca.SX] = {}
    for e in entries.of(EntryKind.J, EntryKind.R, EntryKind.B):
        z = e.origin.u if e.what is EntryKind.B else ca.vertcat(*(entries.model.effort(v) for v in e.rows))
        flow = ca.mtimes(ca.sparsify(e.expr), z) * (-1 if e.what is EntryKind.R else 1)
        for j, s in enumerate(s for v in e.rows for s in ca.vertsplit(v.sx)):
            row[s.element_hash()] = row.get(s.element_hash(), ca.SX(0)) + flow[j]
    massive = [(e.label, v) for e in entries.of(EntryKind.E) for v in e.rows]
    massive += [(pair.label, v) for pair in entries.pairs for v in pair.origin.variables]
    inert = {s.element_hash(): label for label, v in massive for s in ca.vertsplit(v.sx)}
    found = []
    for e in constraints:
        for s in ca.symvar(e.expr):
            symbol = entries.known[s.element_hash()]
            name = symbol.name
            if symbol.kind is not ValueKind.STATE or s.element_hash() in entries.doubtful:
                continue
            text = _no_velocity(entries, ca.SX(ca.simplify(row.get(s.element_hash(), ca.SX(0)))))
            if not text and s.element_hash() in inert:
                text = f"'{name}' has a mass ({inert[s.element_hash()]})"
            if text:
                found.append(
                    Problem("velocity", e.label, f"{name}' is not the effort of a velocity: {text}",
                            f"give J the constant entry 1 between '{name}' and its velocity: skew(q, v, 1.0)")
                )  # fmt: skip
                break
    return found


def _no_velocity(entries: Entries, rate: ca.SX) -> str:
    """Why q' = `rate` is not z_v, "" if it is."""
    symbols = ca.symvar(rate)
    if not symbols:
        return "the rate is constant"
    first = entries.known[symbols[0].element_hash()]
    if len(symbols) > 1 or first.kind is not ValueKind.COSTATE:
        return f"the rate depends on {', '.join(entries.known[s.element_hash()].name for s in symbols[:4])}"
    factor = ca.simplify(ca.gradient(rate, symbols[0]))
    if not factor.is_constant() or float(factor) != 1.0:
        return f"the rate is {factor} times {first.name}"
    return ""


def equations(model: PHDAE, scheme: Scheme | None) -> list[Problem]:
    """The equations can be solved at the start, and the start satisfies their hidden constraints."""
    try:
        built = build_model(model, scheme)
    except DeclarationError as e:
        return [replace(p, rule="solvability", entry=p.entry.removeprefix(f"{model.name}: ")) for p in e.problems]
    try:
        instance = PythonInstance(built)
        signals = instance.signals()
    except StepFailure as e:
        rule = "solvability" if e.status is Status.SINGULAR else "start"
        where = f" ({e.equation}, scaled residual {e.residual:.3g})" if e.equation else ""
        return [Problem(rule, model.name, f"the start cannot be solved: {e.status.value}{where}", remedy(e))]
    found = hidden(built, signals["observables"])
    for name, value in zip(built.observable_names, signals["observables"], strict=False):
        if not np.isfinite(value):
            found.append(
                Problem(
                    "start",
                    f"observable '{name}'",
                    f"is {value} at the start",
                    "write it so that it is defined there",
                )
            )
    return found


def hidden(model: Model, observables: np.ndarray) -> list[Problem]:
    """Hidden constraints (position, velocity, Kirchhoff) the start violates."""
    found = []
    values = observables[len(observables) - len(model.checks) :]
    holonomic = {n for c in model.declaration.constraints for n in c.multiplier.names()}
    for c, value, size in zip(model.checks, values, model.check_scale, strict=True):
        if c.level is Level.POSITION and size < 1e-200:
            text = "the gradient of g(q) is zero at the start, so the multiplier has no effect"
            remedy = "write g with a nonzero gradient where g = 0, e.g. a distance instead of its square"
            found.append(Problem("solvability", f"constraint of '{c.name}'", text, remedy))
        elif not abs(value) <= CONSISTENCY * size:
            what = (
                {Level.POSITION: "g(q)", Level.VELOCITY: "Dg(q) v"}[c.level]
                if c.name in holonomic
                else "sum of flows or efforts"
            )
            said = junction_words(model.declaration, c.name, value) or f"{what} = {value:.6g}"
            found.append(
                Problem("start", f"constraint of '{c.name}'",
                        f"{said} at the start, allowed {CONSISTENCY * size:.3g} (natural size {size:.3g})",
                        "choose start values (states, sources, inputs) that satisfy it")
            )  # fmt: skip
    return found


def moving(model: PHDAE) -> list[Problem]:
    """Hidden constraints of the states that depend on time: a capacitor on an ideal source, a shaft that is driven."""
    if not any(p.source is not None and ca.depends_on(ca.SX(_sx(p.source)), time) for p in model.ports):
        return []
    terms = extract(model)
    holonomic, hidden = {t.rows[0].index for t in terms.of(CONSTRAINT)}, terms.found(HiddenConstraints)
    checks, rows = set(hidden.checks) - holonomic, sorted(hidden.rows)
    if not checks:
        return []
    inputs = [ca.SX(_sx(q.port.source))[q.j] if q.port.source is not None else q.port.u[q.j] for q in terms.pairs]
    z = costate_symbols(model)
    g = flow_expressions(terms, z, ca.vertcat(ca.SX(0, 1), *inputs))[1][rows]
    shared = ca.DM(ca.jacobian_sparsity(g, ca.vertcat(*(v.sx for v in model.algebraics))), 1)
    parts = components(ca.SX(ca.mtimes(shared, shared.T)) + ca.SX.eye(len(rows)))
    found = []
    for part in parts:
        tied = sorted(set(ca.jacobian_sparsity(g[part], z).get_triplet()[1]))
        if not tied or not ca.depends_on(g[part], time) or not checks.intersection(rows[i] for i in part):
            continue
        names = ", ".join(f"'{terms.state_names[i]}'" for i in tied[:4])
        found.append(
            Problem(
                "order", model.name,
                f"{names} {'is' if len(tied) == 1 else 'are'} tied to a source that moves with time, where the switches between "
                "are closed; steps meet it at their nodes only, with order k + 1 (k odd) or k (k even) in place of 2k",
                "put the resistance or the inductance of the source between", "warning",
            )
        )  # fmt: skip
    return found
