"""Holonomic constraints whose positions or velocities are replaced: the velocity form 0 = Dg z_v as a block of J."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from phfmu.declare.block import Block
from phfmu.declare.error import DeclarationError
from phfmu.declare.expressions.dimension import constraint_unit
from phfmu.declare.holonomic import Holonomic
from phfmu.declare.observable import observable
from phfmu.declare.phdae import PHDAE
from phfmu.declare.transform.maps import CoordinateMaps
from phfmu.declare.variable import Variable


def velocity_form(model: PHDAE, T: CoordinateMaps) -> PHDAE:
    """Constraints that `T` touches become blocks -Dg^T on the velocities, Dg on the multiplier; g is reported as `g.<name>`.

    g stays exact along Gauss nodes while it is at most quadratic.  DeclarationError if the start violates g.
    """
    touched = {s.element_hash() for v in T.old for s in ca.vertsplit(v.sx)}
    velocity = _velocities(model)
    kept, blocks, reported = [], [], []
    for c in model.constraints:
        q = [s for s in ca.symvar(c.g) if s.element_hash() in velocity]
        own = {s.element_hash() for s in (*q, *ca.vertsplit(c.multiplier.sx))}
        own |= {velocity[s.element_hash()][0].sx[velocity[s.element_hash()][1]].element_hash() for s in q}
        if not own & touched:
            kept.append(c)
            continue
        if c.drive is not None:
            raise DeclarationError(
                f"{model.name}: constraint '{c.multiplier.name}'",
                "moves (it depends on time) and its velocities are replaced",
                "feed the motion by a port, or leave these variables as they are",
            )
        _require_consistent(model, c, q)
        blocks.append(_block(c, q, velocity))
        text, unit = "constraint, kept by its velocity form", constraint_unit(c.multiplier.unit)
        reported.append(observable(f"g.{c.multiplier.name}", c.g, unit=unit, description=text))
    if not blocks:
        return model
    return replace(
        model,
        constraints=tuple(kept),
        structure=(*model.structure, *blocks),
        observables=(*model.observables, *reported),
    )


def _velocities(model: PHDAE) -> dict[int, tuple[Variable, int]]:
    """Position symbol -> (variable, entry) of the velocity in q' = z_v."""
    out: dict[int, tuple[Variable, int]] = {}
    for b in model.structure:
        place = [(v, j) for v in b.variables for j in range(v.n)]
        for r, c in zip(*b.matrix.sparsity().get_triplet(), strict=True):
            entry = b.matrix[r, c]
            if entry.is_constant() and float(entry) == 1.0:
                (v, j), (w, i) = place[r], place[c]
                if isinstance(w, Variable):
                    out[v.sx[j].element_hash()] = w, i
    return out


def _block(c: Holonomic, q: list[ca.SX], velocity: dict[int, tuple[Variable, int]]) -> Block:
    """J on (velocities, multiplier): [[0, -Dg^T], [Dg, 0]]."""
    variables = list({id(v): v for v, _ in (velocity[s.element_hash()] for s in q)}.values())
    at, n = {}, 0
    for v in variables:
        at[id(v)] = n
        n += v.n
    G = ca.SX(c.multiplier.n, n)
    for s in q:
        v, j = velocity[s.element_hash()]
        G[:, at[id(v)] + j] += ca.jacobian(c.g, s)
    G = ca.sparsify(G)
    m = c.multiplier.n
    matrix = ca.vertcat(ca.horzcat(ca.SX(n, n), -G.T), ca.horzcat(G, ca.SX(m, m)))
    return Block((*variables, c.multiplier), matrix, c.owner)


def _require_consistent(model: PHDAE, c: Holonomic, q: list[ca.SX]) -> None:
    known = {s.element_hash(): (a, b) for v in (*model.states, *model.parameters)
             for s, a, b in zip(ca.vertsplit(v.sx), v.start, v.nominal, strict=True)}  # fmt: skip
    symbols = ca.symvar(c.g)
    start = np.array([known[s.element_hash()][0] for s in symbols])
    size = np.array([max(abs(known[s.element_hash()][0]), known[s.element_hash()][1]) for s in symbols])
    f = ca.Function("g", [ca.vertcat(*symbols)], [c.g, ca.densify(ca.jacobian(c.g, ca.vertcat(*symbols)))])
    g, D = (np.array(a) for a in f(start))
    allowed = 1e-8 * np.abs(D) @ size
    bad = np.flatnonzero(np.abs(g.ravel()) > allowed)
    if bad.size:
        raise DeclarationError(
            f"{model.name}: constraint '{c.multiplier.names()[bad[0]]}'",
            f"g(q) = {g.ravel()[bad[0]]:.6g} at the start",
            "choose positions that satisfy it",
            "start",
        )
