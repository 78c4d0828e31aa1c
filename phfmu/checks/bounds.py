"""Warnings on the form of H: terms without states, and where it is quadratic and not bounded below."""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from phfmu.checks.sample import Sample
from phfmu.declare.energy import EnergyKind
from phfmu.declare.entries import Entries
from phfmu.declare.entry_kind import EntryKind
from phfmu.declare.problem import Problem
from phfmu.declare.value import Value

NEGATIVE = 1e-9  # of the largest eigenvalue


def constants(entries: Entries, sample: Sample) -> list[Problem]:
    """Energy terms without a state: they never change and are left out."""
    return [
        Problem(
            "energy", e.label, "no state in it, so it never changes: it is left out of H",
            "remove it, or check if a state was meant", "warning",
        )
        for e in entries.of(EntryKind.H) if not _hashes(entries, e.expr, Value.STATE)
    ]  # fmt: skip


def bounded(entries: Entries, sample: Sample) -> list[Problem]:
    """The constant Hessian of states that occur in quadratic terms only has no negative eigenvalue.

    In the nominal sizes of the states, at the start values of the parameters.  What other terms may hold back is not judged.
    """
    quadratic = [e for e in entries.of(EntryKind.H) if e.origin.kind is EnergyKind.QUADRATIC]
    others = [e.expr for e in entries.of(EntryKind.H) if e.origin.kind is not EnergyKind.QUADRATIC]
    others += [ca.SX(p.origin.hamiltonian) for p in entries.pairs]
    held = set().union(*(_hashes(entries, expr, Value.STATE) for expr in others))
    total = ca.SX(0)
    for e in quadratic:
        total += e.expr
    x = ca.vertcat(*(s for s in ca.symvar(total) if s.element_hash() in _hashes(entries, total, Value.STATE) - held))
    if not x.numel():
        return []
    hessian = ca.hessian(total, x)[0]
    rows, columns = hessian.sparsity().get_triplet()
    entry = hessian.nz[:]
    rest = ca.symvar(entry)
    start = {
        s.element_hash(): v for q in entries.model.parameters for s, v in zip(ca.vertsplit(q.sx), q.start, strict=True)
    }
    given = [start.get(s.element_hash(), 0.0) for s in rest]
    values = ca.Function("h", [ca.vertcat(ca.SX(0, 1), *rest)], [entry])(given).full().ravel()
    size = sample.size[[sample.place[x[j].element_hash()] for j in range(x.numel())]]
    scaled = csr_matrix((values * size[rows] * size[columns], (rows, columns)), shape=hessian.shape)
    found = []
    for part in range((groups := connected_components(scaled, directed=False))[0]):
        where = np.flatnonzero(groups[1] == part)
        block = scaled[where][:, where].toarray()
        if not np.isfinite(block).all():
            continue
        value, vector = np.linalg.eigh(block)
        if value[0] < -NEGATIVE * np.abs(value).max():
            names = [entries.known[x[int(j)].element_hash()].name for j in where]
            found.append(_unbounded(entries, value[0], vector[:, 0], names, _used(entries, rest, given)))
    return found


def _unbounded(entries: Entries, value: float, vector: np.ndarray, names: list[str], parameters: str) -> Problem:
    vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
    order = [j for j in np.argsort(-np.abs(vector)) if abs(vector[j]) > 1e-6]
    along = ", ".join(f"{names[j]} = {vector[j]:.3g}" for j in order[:6]) + (", .." if len(order) > 6 else "")
    text = f"H is not bounded below: along {along} (in nominal sizes) its Hessian has the eigenvalue {value:.4g} J{parameters}"
    remedy = "energy can be drawn without end while the balance closes; correct signs or parameters"
    return Problem("bounded", entries.model.name, text, remedy, "warning")


def _used(entries: Entries, symbols: list[ca.SX], values: list[float]) -> str:
    found = [f"{entries.known[s.element_hash()].name} = {v:g}" for s, v in zip(symbols, values, strict=True)]
    return f" (with {', '.join(found[:6])}{', ..' if len(found) > 6 else ''})" if found else ""


def _hashes(entries: Entries, expr: ca.SX, kind: Value) -> set[int]:
    return {s.element_hash() for s in ca.symvar(expr) if entries.known[s.element_hash()].kind is kind}
