"""A declaration under a system transformation (phi, U), part by part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from phfmu.declare.block import Block
from phfmu.declare.energy import Energy, energy
from phfmu.declare.entries.coefficients import coefficient
from phfmu.declare.error import DeclarationError
from phfmu.declare.observable import Observable
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.declare.transform.change import VariableChange
from phfmu.declare.transform.maps import CoordinateMaps
from phfmu.declare.transform.transformed_constraints import velocity_form
from phfmu.declare.transform.transformed_pair import costates, descriptor, singular_costates
from phfmu.declare.variable import VariableKind, key


def transformed(model: PHDAE, T: CoordinateMaps) -> PHDAE:
    """`model` in the new variables of `T`; see `SystemTransformation`."""
    if model.state_events or model.switches:
        named = [e.guard.name for e in model.state_events] + [s.name for s in model.switches]
        names = ", ".join(f"'{n}'" for n in named[:4])
        raise DeclarationError(
            model.name, f"has state events or switches ({names}), which act along its own variables",
            "change the variables first, and declare the events in the new ones", "symbol",
        )  # fmt: skip
    model = velocity_form(model, T)
    change = VariableChange(model, T)
    E = descriptor(change)
    z = costates(change)
    energies = tuple(_energy(change, e) for e in model.energies)
    return replace(
        model,
        states=change.listed(model.states, VariableKind.STATE),
        algebraics=change.listed(model.algebraics, VariableKind.ALGEBRAIC),
        energies=energies,
        E=E,
        z=z | singular_costates(change, E),
        structure=tuple(_block(change, b, -1) for b in model.structure),
        dissipation=tuple(_block(change, b, 1) for b in model.dissipation),
        ports=tuple(_port(change, p) for p in model.ports),
        observables=tuple(replace(o, expr=change.expr(o.expr)) for o in model.observables) + _reported(change),
    )


def _energy(change: VariableChange, e: Energy) -> Energy:
    """H o phi, without the new algebraic variables; a quadratic or strain term stays one if phi is affine."""
    if not ca.depends_on(e.expr, ca.vertcat(*(v.sx for v in change.old))):
        return e
    a = change.T.x[change.algebraics]
    h = change.at_old(e.expr)
    fixed = (
        ca.DM.zeros(a.numel())
        if change.T.affine
        else ca.DM([s for v in change.new if v.kind is VariableKind.ALGEBRAIC for s in v.start])
    )
    if a.numel():
        _require_independent(change, e, h, a)
    keep = [v for v in e.correct if key(v) not in change.row]
    correct = (
        tuple(keep + [v for v in change.new if v.kind is VariableKind.STATE])
        if len(keep) < len(e.correct)
        else e.correct
    )

    def without(expr: ca.SX) -> ca.SX:
        return ca.substitute([change.at_old(expr)], [a], [fixed])[0] if a.numel() else change.at_old(expr)

    if not change.T.affine:
        return energy(without(e.expr), correct=correct, owner=e.owner)
    invariant = None if e.invariant is None else without(e.invariant)
    return replace(e, expr=without(e.expr), invariant=invariant, correct=correct)


def _require_independent(change: VariableChange, e: Energy, h: ca.SX, a: ca.SX) -> None:
    x = ca.vertcat(*(v.sx for v in change.old))
    size = ca.mtimes(ca.fabs(change.T.jacobian[:, change.algebraics]).T, ca.fabs(change.at_old(ca.gradient(e.expr, x))))
    value, scale = change.sampled([ca.densify(ca.gradient(h, a)), ca.densify(size)])
    bad = np.argwhere(np.abs(value) > 1e-9 * scale)
    if len(bad):
        i, j, _ = bad[0]
        name = [n for v in change.new if v.kind is VariableKind.ALGEBRAIC for n in v.names()][j]
        raise DeclarationError(
            change.model.name,
            f"H depends on the algebraic variable '{name}', dH/d({name}) = {value[i, j, 0]:.6g} with parts "
            f"of {scale[i, j, 0]:.3g}; H may depend on the states only (E^T z = grad H makes it so)",
            "correct H, z or E",
            "energy",
        )


def _projection(change: VariableChange, variables: Sequence[Any]) -> tuple[list[Any], ca.SX]:
    """New rows of a block and P with z_old = P z_new on the rows of `variables`."""
    kept = [v for v in variables if key(v) not in change.row]
    rows = sum(v.n for v in variables)
    P = [ca.SX(rows, v.n) for v in kept] + [ca.SX(rows, v.n) for v in change.new]
    at = 0
    for v in variables:
        span = slice(at, at + v.n)
        if key(v) in change.row:
            for j, w in enumerate(change.new):
                P[len(kept) + j][span, :] = change.U[change.row[key(v)], change.column[key(w)]]
        else:
            P[kept.index(v)][span, :] = ca.SX.eye(v.n)
        at += v.n
    used = [(v, ca.sparsify(p)) for v, p in zip([*kept, *change.new], P, strict=True)]
    used = [(v, p) for v, p in used if p.nnz()]
    return [v for v, _ in used], ca.horzcat(*(p for _, p in used))


def _block(change: VariableChange, b: Block, sign: int) -> Block:
    """P^T M P, exactly skew (sign -1) or symmetric (sign 1); a block with a factor G has G P."""
    b = b.changed(change.expr)
    if not any(key(v) in change.row for v in b.variables):
        return b
    variables, P = _projection(change, b.variables)
    if b.factor is not None:
        factor, _ = change.product(ca.SX.eye(b.factor.shape[0]), b.factor, P)
        return replace(b, variables=tuple(variables), factor=factor)
    matrix, _ = change.product(P.T, b.value, P)
    upper = ca.triu(matrix, sign > 0)
    return replace(b, variables=tuple(variables), value=ca.sparsify(upper + sign * ca.triu(matrix, False).T))


def _port(change: VariableChange, p: Port) -> Port:
    """B~ = P^T B."""
    on = {v: change.expr(m) for v, m in p.on.items() if key(v) not in change.row}
    touched = [v for v in p.on if key(v) in change.row]
    if touched:
        variables, P = _projection(change, touched)
        stack = ca.vertcat(*(coefficient(p.on[v], v.n, p.n) for v in touched))
        (B, _), at = change.product(P.T, change.expr(stack), ca.SX.eye(p.n)), 0
        for v in variables:
            part = B[at : at + v.n, :]
            at += v.n
            if part.nnz():
                on[v] = part
    return replace(p, on=on)


def _reported(change: VariableChange) -> tuple[Observable, ...]:
    """The old variables as observables."""
    new = {key(v) for v in change.new}
    return tuple(
        Observable(v.name, ca.vec(change.T.image[change.row[key(v)]]), v.unit, v.description, elements=v.elements)
        for v in change.old
        if key(v) not in new
    )
