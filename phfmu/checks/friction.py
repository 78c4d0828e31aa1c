"""Forces that jump where a velocity passes zero (Coulomb friction): set-valued there, so that no step has one there."""

from __future__ import annotations

import casadi as ca
import numpy as np

from phfmu.checks.sample import Sample
from phfmu.declare.entries.entries import Entries, Entry
from phfmu.declare.entries.entry_kind import EntryKind
from phfmu.declare.error import Problem
from phfmu.declare.variable import key

#: velocities on both sides of zero, as parts of what is typical
NEAR = 1e-9
#: of the force at a typical velocity: what it may change by between them
JUMP = 1e-3


def friction(entries: Entries, sample: Sample) -> list[Problem]:
    """The forces R z of dissipation are continuous where z passes zero."""
    chosen = [e for e in entries.of(EntryKind.R) if not e.expr.is_constant()]
    s = ca.SX.sym("s")
    along = [_along(entries, sample, e, s) for e in chosen]
    sides = [sample.values(along, (s, np.full((sample.n, 1), at))) for at in (-NEAR, NEAR, 1.0)]
    found = []
    for e, below, above, typical in zip(chosen, *sides, strict=True):
        with np.errstate(invalid="ignore"):
            jump, scale = np.abs(above - below).max(axis=(1, 2)), np.abs(typical).max(axis=(1, 2))
            bad = np.flatnonzero(jump > JUMP * scale)
        if bad.size:
            text = f"its force jumps by {jump[bad[0]]:.3g} where the velocity passes zero (Coulomb friction)"
            remedy = "round it off: F/sqrt(v^2 + v0^2) in place of F/|v|, with a small v0; sticking has no mode"
            found.append(Problem("friction", e.label, text, remedy))
    return found


def _along(entries: Entries, sample: Sample, e: Entry, s: ca.SX) -> ca.SX:
    """R z with the variables of the block at s times a point of typical size, and their costates at s."""
    rng = np.random.default_rng(5)
    efforts, old, new = [], list[ca.SX](), list[ca.SX]()
    for v in e.rows:
        direction = ca.DM(rng.uniform(0.5, 1.0, v.n) * (-1.0) ** np.arange(len(efforts), len(efforts) + v.n))
        size = ca.DM(sample.size[list(sample.rows(v))] if key(v) in sample.place else np.asarray(v.nominal, float))
        efforts += ca.vertsplit(s * direction)
        old.append(v.sx)
        new.append(s * direction * size)
        if key(v) in sample.place:
            old.append(v.z)
            new.append(s * direction)
    (matrix,) = ca.substitute([e.expr], [ca.vertcat(*old)], [ca.vertcat(*new)])
    return ca.densify(ca.mtimes(matrix, ca.vertcat(*efforts)))
