"""Velocities of positions: rows q' = z_v, on which the multipliers of constraints g(q) act."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from phfmu.declare.variable import ValueKind
from phfmu.terms.located import Constant, Row
from phfmu.terms.term import Terms


@dataclass(frozen=True)
class Velocities:
    """Position -> velocity."""

    of: Mapping[int, int] = field(default_factory=dict)


def velocity_of(terms: Terms) -> Mapping[int, int]:
    """Position -> velocity, as `extract` has found them."""
    return terms.found(Velocities).of


def velocities(terms: Terms) -> Velocities:
    """Positions with one constant unit entry z_v in their rows, from the constant entries of J."""
    other = terms.with_descriptor()
    rows: dict[int, list[Constant]] = {}
    for c in terms.constants:
        if c.row.kind is Row.BALANCE:
            rows.setdefault(c.row.index, []).append(c)
    single = {q: found[0] for q, found in rows.items() if len(found) == 1 and q not in other}
    return Velocities(
        {q: c.source.index for q, c in single.items() if c.source.kind is ValueKind.COSTATE and c.value == 1.0}
    )
