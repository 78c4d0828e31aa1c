"""Whether the energy of coupled members grows beyond all that they had and were given."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.members.predicted_member import POOR
from phfmu.outcome.status import Status, StepFailure

Array = NDArray[np.float64]

LIMIT = 1e6  # times the energy at the start with what was supplied since


class EnergyGrowth:
    """Energies of the start and through free ports since, as absolute values; `LIMIT` times that is beyond any physics.

    Units whose energy is estimated count from zero: what they gave at most is what they had, or have from inside.
    """

    CARRIED = ("known", "had")

    def __init__(self, joined: CoupledMembers):
        self._joined = joined
        ports = joined.booking.ports
        self._outer = [i for i, p in enumerate(ports) if p.junction is None]
        self._inner = [i for i, p in enumerate(ports) if p.junction is not None]
        self._estimated = [c in joined.booking.estimated for c in joined.booking.components]
        self.known, self.had = 0.0, 0.0

    def given(self, H: Array) -> None:
        """Energies at the start, or what an event changed in them."""
        self.known += float(np.abs(H).sum())

    def within(self, H: Array, pairs: Array) -> int:
        """Number of steps, a row each, before one runs away; the check of `watch` for members whose energy is known."""
        known = self.known + np.cumsum(np.abs(pairs[:, self._outer]).sum(axis=1))
        away = ~(np.abs(H).sum(axis=1) <= LIMIT * known)
        n = int(away.argmax()) if away.any() else len(H)
        self.known = float(known[n - 1]) if n else self.known
        return n

    def watch(self, t: float, h: float, H: Array, pairs: Array) -> None:
        """After a step from t with energies H and energy through `pairs`; raises StepFailure where they have run away."""
        known = self.known + float(np.abs(pairs[self._outer]).sum())
        total = float(np.abs(H).sum())
        poor = [m.name for m in self._joined.put_off if m.missed > POOR]
        if not poor:  # what such a unit seems to give is an artefact
            self.had = max(self.had, float(-H[self._estimated].clip(max=0.0).sum()))
        known_here = known + self.had
        if not total <= LIMIT * known_here and (known_here or not any(self._estimated)):
            made = float(pairs[self._inner].sum())
            raise StepFailure(
                Status.GROWTH, self._joined.network.name, t, h, joined=True, composable=self._joined.network.composable,
                put_off=", ".join(m.name for m in self._joined.put_off),
                tried=f"energy {total:.3g} J, {known_here:.3g} J at the start and supplied since; in this step the junctions "
                f"supplied {made:.3g} J",
            )  # fmt: skip
        self.known = known
