"""What the states of coupled members violate at their junctions at one instant, and starts that do."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from phfmu.declare.junction_words import spread_words
from phfmu.declare.port import conjugate
from phfmu.network.couplings.joined import Joined
from phfmu.network.couplings.matrices import DENSE
from phfmu.network.junctions.hidden import hidden_part
from phfmu.network.junctions.junction import Junction
from phfmu.network.junctions.unknowns import junction_unknowns
from phfmu.network.members.consistent import MONOLITHIC, inconsistent
from phfmu.signals import SUM

Array = NDArray[np.float64]

CONSISTENT = 1e-7  # a sum below this part of the largest output it is made of, and of
UNIT = 1e-6  # this where all of them are zero


class EndSums:
    """Per common variable: the sum of the joined flows (efforts) at the present time.

    A junction with dual inputs meets its sum by them; there it is the spread of the outputs that must be equal.
    Zero where outputs follow the junction unknowns.
    """

    def __init__(self, joined: Joined):
        self.joined = joined
        face = joined.face
        self.names = [SUM + n for n in face.sum_names()]
        self._rows = face.rows_of_sums()
        self._starts = np.cumsum([0, *map(len, self._rows)])[:-1]
        self._single = np.array([len(own) == 1 for own in self._rows], bool)
        self._gathered = np.concatenate([*self._rows, np.zeros(0, int)]).astype(int)
        self._maps: tuple[Any, Any, Any] | None = None

    @property
    def units(self) -> dict[str, str]:
        """Of the names: what is summed has the unit of the flow where the effort is common, and the reverse."""
        network, told = self.joined.network, {}
        for j in network.junctions:
            common, domain = (
                junction_unknowns(network.members, j).common,
                next(iter(j.ports(network.members).values())).domain,
            )
            unit = domain.unit(conjugate(j.shared))
            told |= {SUM + n: unit for n in common.names()}
        return told

    def forget(self) -> None:
        """After parameters or inputs were set: outputs may follow other unknowns."""
        self._maps = None

    def values(self, xi: Array) -> Array:
        """The sums, with the junction unknowns xi."""
        if self._maps is None:
            self._maps = self._found(xi)
        return self.of_rows(xi[None], self.joined.end_outputs()[None])[0]

    @property
    def known(self) -> bool:
        """Whether `of_rows` knows which outputs follow the junction unknowns."""
        return self._maps is not None

    @property
    def hide(self) -> bool:
        """Whether there are sums that no junction unknown changes at an instant, once `values` was asked for."""
        return self._maps is not None and bool(len(self.names)) and float(abs(self._maps[2]).max()) > UNIT

    @property
    def held_outputs(self) -> NDArray[np.bool_]:
        """Which outputs (nu) are in rows that no junction unknown changes at an instant, once `values` was asked for."""
        assert self._maps is not None
        P, _, Q = self._maps
        return np.asarray(abs(P @ Q).sum(axis=1)).ravel() > UNIT

    def of_rows(self, xi: Array, y: Array) -> Array:
        """The sums (steps x names) with junction unknowns xi and outputs y at ends, a row a step."""
        assert self._maps is not None
        P, C, Q = self._maps
        r = (y @ P + xi @ C) @ Q
        if not len(self._rows):
            return np.zeros((len(xi), 0))
        r = r[:, self._gathered]
        spread = np.maximum.reduceat(r, self._starts, axis=1) - np.minimum.reduceat(r, self._starts, axis=1)
        return np.where(self._single, r[:, self._starts], spread)

    def require_zero(self, xi: Array) -> None:
        """InconsistentState if joined flows (efforts) of states do not sum to zero."""
        face, network = self.joined.face, self.joined.network
        sums = self.values(xi)
        size = face.summed(np.abs(self.joined.end_outputs()))
        bad = []
        at = [j for j in network.junctions for _ in range(network.port_of(j.ends[0]).n)]
        rows = zip(at, face.commons(), face.sum_names(), sums, self._rows, strict=True)
        for j, common, n, v, own in rows:
            if not abs(v) <= CONSISTENT * (size[own].max() + UNIT):
                pure = own[0] == common
                bad.append(f"{n}: sum {v:.6g}" if pure else f"{n}: {self._differ(j, v)}")
        if bad:
            instead = f", or {MONOLITHIC}" if network.composable else ""
            rule = "joined flows of states must sum to zero and joined outputs must be equal at the start"
            raise inconsistent(network.name, bad, f"{rule}: change the start values{instead}")

    def _found(self, xi: Array) -> tuple[Any, Any, Any]:
        """P, C^T, Q^T with the projector Q to what no junction unknown can change; sparse where there are many."""
        face = self.joined.face
        Q = hidden_part(self.joined.instant_matrix(xi), face.nominal)
        maps = face.P, face.C.T, Q.T
        return tuple(m.toarray() for m in maps) if Q.shape[0] <= DENSE else tuple(map(csr_array, maps))  # pyright: ignore

    def _differ(self, junction: Junction, value: float) -> str:
        ports = junction.ports(self.joined.network.members)
        givers = {str(e): p for e, p in ports.items() if p.given != junction.shared}
        return spread_words(next(iter(givers.values())), tuple(givers), value)
