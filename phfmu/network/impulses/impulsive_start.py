"""Starts of members stepped apart, and states after events, that violate the rows of their junctions: moved as by an impulse.

With B the directions of impulses a in the unknowns of the interface, those that make their rows c = B^T P^T y zero are

    a = -S^-1 c,   S = B^T (sum_j P_j^T S_j P_j) B,      x_j -> x_j + L_j P_j B a,      energy of all members: -c.S^-1 c / 2,

which is what the composed model does (`discretise/start.py`). Where S is singular the smallest a is taken. Units do it if they
have impulses.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.start import Projection
from phfmu.network.interface.bare_columns import clusters
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.impulse_directions import directions
from phfmu.network.interface.matrices import summed
from phfmu.network.interface.unknowns import InterfaceUnknowns
from phfmu.network.members.node_values import InstanceNodes
from phfmu.signals import of_member
from phfmu.terms.bare import SINGULAR

if TYPE_CHECKING:
    from phfmu.network.members.engine_member import EngineMember
    from phfmu.network.members.fmu_member import FMUMember

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

MOST, SHRINKING = 12, 0.5  # trials; sums that shrink to more than this part of the last are rounding


@dataclass(frozen=True)
class ImpulseTarget:
    """A member that impulses act on; to: its impulses by those of a that reach it (at)."""

    member: EngineMember | FMUMember
    values: InstanceNodes
    at: Ints
    to: Array


def project_start(joined: CoupledMembers, t: float, kept: Sequence[str]) -> Projection:
    """Moves the members; what has moved.

    Members know their own constraints only: ValueError tells what to do where no junction can do that, and of `kept` states.
    """
    exchange, network = InterfaceUnknowns(joined), joined.network
    kicked = [
        s.place.start + np.array(s.values.offer.kicked, int) for s in exchange.shares if s.values.offer is not None
    ]
    names, B = directions(joined.face, kicked)
    if names and not kept:
        return _project(exchange, names, B, t)
    composed = "use --coupling monolithic" if network.composable else "start its units where the junctions hold"
    without = [s.values.member.name for s in exchange.shares if s.values.offer is None and s.fed]
    if kept:
        reason, remedy = f"states that are kept ({', '.join(kept)}) belong to one composed model", composed
    elif without:
        reason = f"{', '.join(without)} take{'s' if len(without) == 1 else ''} no impulses"
        remedy = f"export units with --node-inputs or --impulses, or {composed}"
    else:
        reason, remedy = "no junction of it constrains states", composed
    raise ValueError(f"{network.name}: a coupled network cannot be projected at t = {t:g} s: {reason}; {remedy}")


def _project(exchange: InterfaceUnknowns, names: list[str], B: Any, t: float) -> Projection:
    """By a, more than once where S changes along it."""
    joined = exchange.joined

    def violated() -> Array:
        return B.T @ joined.face.summed(joined.end_outputs())

    moved = list(_moved(exchange, B))
    start, H, c = [m.member.states for m in moved], joined.energies(), [violated()]
    while len(c) < MOST and (len(c) < 2 or np.abs(c[-1]).max() < SHRINKING * np.abs(c[-2]).max()):
        S = summed(len(names), ((m.at, m.at, m.to.T @ m.values.jump() @ m.to) for m in moved))
        a = np.zeros(len(names))
        for own in clusters(S):
            a[own] = -np.linalg.pinv(S[own][:, own].toarray(), rcond=SINGULAR, hermitian=True) @ c[-1][own]
        for m in moved:
            m.member.shift(m.to @ a[m.at], t)
        c.append(violated())
    changes = [
        (of_member(m.member.name, n), a, b) for m, x in zip(moved, start, strict=True)
        for (n, a), b in zip(x.items(), m.member.states.values(), strict=True) if a != b
    ]  # fmt: skip
    before, after = (dict(zip(names, map(float, v), strict=True)) for v in (c[0], c[-1]))
    return Projection(np.zeros(0), tuple(changes), before, after, float((joined.energies() - H).sum()))


def _moved(exchange: InterfaceUnknowns, B: Any) -> Iterator[ImpulseTarget]:
    for i, s in enumerate(exchange.shares):
        own, P = exchange.joined.reach(i)
        part = B[own]
        at = np.unique(part.indices)
        if isinstance(s.values, InstanceNodes) and s.values.offer is not None and len(at):
            yield ImpulseTarget(s.values.member, s.values, at, (P @ part[:, at].toarray())[s.values.offer.kicked])
