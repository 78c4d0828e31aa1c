"""Limits of reactive power: a regulator that would have to deliver more holds its limit instead of its voltage.

A `PV` with Q beyond [Q_min, Q_max] becomes a `PQ` at the limit; one at its upper (lower) limit whose voltage rises above (falls
below) what it is to hold is a `PV` again.  All that are wrong change at once, as in power flow programs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from phfmu.operating.specifications import PQ, PV, Specification
from phfmu.operating.system import NoOperatingPoint
from phfmu.words import first_few

#: relative rounding of powers and voltages
ROUNDING = 1e-9
#: solutions until all stay;  how often a regulator gets its voltage back, after which it keeps its limit
ROUNDS, BACK = 30, 2


class Switching:
    """`now`: the specifications to solve with, in the order of those that were asked for."""

    def __init__(self, network: str, asked: Sequence[Specification]):
        self._network, self._asked, self._rounds = network, asked, 0
        self.now = list(asked)
        self._back = [0] * len(self.now)

    @property
    def limited(self) -> dict[str, float]:
        """Delivered reactive power in var of those at a limit, by port."""
        both = zip(self._asked, self.now, strict=True)
        return {now.port: now.Q for asked, now in both if isinstance(now, PQ) and isinstance(asked, PV)}

    def moved(self, point: Any) -> bool:
        """Whether some change sides at a point (`NetworkPoint`); NoOperatingPoint where they go on to."""
        after = [self._of(i, asked, point) for i, asked in enumerate(self._asked)]
        changed = [a.port for a, b in zip(after, self.now, strict=True) if a is not b]
        self.now, self._rounds = after, self._rounds + 1
        if changed and self._rounds >= ROUNDS:
            raise NoOperatingPoint(
                f"{self._network}: limits of reactive power are hit and left in turn at {first_few(changed)}; widen them, or "
                "give these units P and Q"
            )
        return bool(changed)

    def _of(self, i: int, asked: Specification, point: Any) -> Specification:
        now = self.now[i]
        if not isinstance(asked, PV):
            return now
        low, high = asked.Q
        if isinstance(now, PV):
            Q = -point.power(asked.port).imag
            limit = max(low, min(high, Q))
            beyond = abs(Q - limit) > ROUNDING * max(abs(Q), abs(asked.P))
            return PQ(asked.port, asked.free, P=asked.P, Q=limit) if beyond else now
        assert isinstance(now, PQ)
        V = point.magnitude(point.junction_of(asked.port))
        leaves = V > (1.0 + ROUNDING) * asked.V if now.Q == high else V < (1.0 - ROUNDING) * asked.V
        if not leaves or self._back[i] >= BACK:
            return now
        self._back[i] += 1
        return asked
