"""Starts of members stepped apart, and states after events, that violate the sums at nodes of states: moved as by an impulse.

Where all ports of a junction take impulses, those of its common variables that make its sums c zero are

    m = -S^-1 c,      x_j -> x_j + L_j P_j m,      energy of the members together: -c.S^-1 c / 2,

which is what the composed model does (`discretise/start.py`). Where S is singular the smallest m is taken.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.start import Projection
from phfmu.network.couplings.exchange import Exchange, Share
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.member import Member
from phfmu.terms.bare import SINGULAR

Array = NDArray[np.float64]

MOST, SHRINKING = 12, 0.5  # trials; sums that shrink to more than this part of the last are rounding


def movable(exchange: Exchange) -> bool:
    """Whether there are such nodes, and engines step all of their members: the state of a unit is its own."""
    return bool(exchange.offered) and all(isinstance(s.values.member, EngineMember) for s, _ in _shares(exchange))


def moved_start(exchange: Exchange, t: float) -> Projection:
    """Moves the members by m, more than once where S changes along it; what has moved."""
    joined, shares = exchange.joined, list(_shares(exchange))
    members = [s.values.member for s, _ in shares]
    start, H = [_states(m) for m in members], joined.energies()
    c = [_sums(exchange)]
    while len(c) < MOST and (len(c) < 2 or np.abs(c[-1]).max() < SHRINKING * np.abs(c[-2]).max()):
        S = sum((Q.T @ s.values.jump() @ Q for s, Q in shares), np.zeros((len(c[0]),) * 2))
        m = -np.linalg.pinv(S, rcond=SINGULAR, hermitian=True) @ c[-1]
        for (_, Q), member in zip(shares, members, strict=True):
            if isinstance(member, EngineMember):
                member.shift(Q @ m, t)
        c.append(_sums(exchange))
    moved = [
        (f"{m.name}.{n}", a, b) for m, x in zip(members, start, strict=True)
        for (n, a), b in zip(x.items(), _states(m).values(), strict=True) if a != b
    ]  # fmt: skip
    names = [joined.face.names[i] for i in exchange.offered]
    before, after = (dict(zip(names, map(float, v), strict=True)) for v in (c[0], c[-1]))
    return Projection(np.zeros(0), tuple(moved), before, after, float((joined.energies() - H).sum()))


def _shares(exchange: Exchange) -> Iterator[tuple[Share, Array]]:
    """Members at such nodes, and their impulses by those of the common variables."""
    for s in exchange.shares:
        P = exchange.joined.face.P[s.place]
        if s.values.offer is not None and P[:, exchange.offered].any():
            yield s, P[s.values.offer.kicked][:, exchange.offered]


def _sums(exchange: Exchange) -> Array:
    return (exchange.joined.end_outputs() @ exchange.joined.face.P)[exchange.offered]


def _states(member: Member) -> dict[str, float]:
    if not isinstance(member, EngineMember):
        return {}
    names = [n for v in member.model.declaration.states for n in v.names()]
    return dict(zip(names, map(float, member.instance.x), strict=True))
