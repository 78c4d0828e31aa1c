"""Losses of projecting impulses at nodes of saturating branches, from the states and unknowns of steps.

At the end of a step x1 = x1* + s, s = L m, and c(x1) = 0: on the members the impulse does the work

    W = -m.int_0^1 c(x1 - (1 - t) s) dt <= 0

(`schemes/impulses.py`), which a composed model books through the ports of the junction. Here it is found again, apart from what
ports and books say, so that the junction's energy can be held against it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.audit.booking import PROJECTION, PartKey
from phfmu.declare.variable import ValueKind
from phfmu.discretise.model import Model
from phfmu.discretise.onestep import step_layout
from phfmu.gradients.quadrature import gauss
from phfmu.plan.layout import Layout
from phfmu.plan.plan import Plan
from phfmu.schemes.constraints.impulses import END_SHIFT, ROOT, WORK_POINTS
from phfmu.terms.bare import IMPULSE, Remedy
from phfmu.terms.extraction.extract import extract
from phfmu.terms.located import Row
from phfmu.terms.term import Term

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ProjectionLosses:
    """The share of one member: W (rows) of its states x1, parameters p, shifts s and impulses m, their places, and its parts."""

    work: ca.Function
    x: list[int]
    p: list[int]
    s: list[int]
    m: list[int]
    part: list[int]


class Projections:
    """Losses of projections of a composed model; `keys`: the parts of junctions that they are, empty where there are none."""

    def __init__(self, model: Model):
        self._model = model

    @cached_property
    def keys(self) -> tuple[PartKey, ...]:
        return self._found[0]

    def losses(self, x: Array, unknowns: Array, parameters: Array) -> Array:
        """W (steps x keys) of steps that end at states x (steps x nx) with their unknowns (steps x nw)."""
        keys, shares = self._found
        out = np.zeros((len(x), len(keys)))
        for s in shares:
            values = (
                x[:, s.x],
                np.broadcast_to(parameters[s.p], (len(x), len(s.p))),
                unknowns[:, s.s],
                unknowns[:, s.m],
            )
            found = np.array(s.work.map(len(x))(*(v.T for v in values))).T
            for j, part in enumerate(s.part):
                out[:, part] += found[:, j]
        return out

    @cached_property
    def _found(self) -> tuple[tuple[PartKey, ...], list[ProjectionLosses]]:
        d, scheme = self._model.declaration, self._model.scheme
        if not d.junctions or not _projects(self._model.step):
            return (), []
        layout = step_layout(extract(d, joint=scheme.joint), scheme)
        terms, at = layout.terms, {end: name for name, ends in d.junctions for end in ends}
        junctions = {
            row: at[terms.pairs[i].port.name] for i, row in terms.bound.items() if terms.pairs[i].port.name in at
        }
        projecting = [t for t in terms.of(IMPULSE) if t.form is Remedy.PROJECTION]
        own = [junctions[r] for t in projecting for r in _rows(t)]
        keys = tuple(PartKey(name, PROJECTION) for name, _ in d.junctions if name in own)
        place = {key.junction: i for i, key in enumerate(keys)}
        return keys, [_share(t, layout, [place[junctions[r]] for r in _rows(t)]) for t in projecting]


def _projects(plan: Plan) -> bool:
    """Whether a mean holds one impulse: pairs have an impulse at the start and roots at the end."""
    impulses = plan.mean_a[plan.mean_pow == -1]
    return bool((np.bincount(impulses) == 1).any())


def _rows(term: Term) -> Iterator[int]:
    return (r.index for r in term.rows if r.kind is Row.EQUATION)


def _share(term: Term, layout: Layout, part: list[int]) -> ProjectionLosses:
    states = [r.index for r in term.rows if r.kind is Row.BALANCE]
    x, p = term.symbols(ValueKind.STATE), term.symbols(ValueKind.PARAMETER)
    s, m = ca.SX.sym("s", len(states)), ca.SX.sym("m", len(part))
    shift = ca.vertcat(s, ca.SX(x.numel() - len(states), 1))

    def c(t: float) -> Any:
        return ca.substitute(term.data["c"], x, x - (1.0 - t) * shift)

    work = -m * sum(float(w) * c(float(t)) for t, w in zip(*gauss(WORK_POINTS), strict=True))
    return ProjectionLosses(
        ca.Function("work", [x, p, s, m], [work]), list(term.indices(ValueKind.STATE)), list(term.indices(ValueKind.PARAMETER)),
        [layout.at(END_SHIFT, i, 0) for i in states], [layout.at(ROOT, r, 0) for r in _rows(term)], part,
    )  # fmt: skip
