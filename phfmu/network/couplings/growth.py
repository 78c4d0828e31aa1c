"""Whether the energy of coupled members grows beyond all that they had and were given."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.status import Status, StepFailure
from phfmu.network.couplings.joined import Joined

Array = NDArray[np.float64]

LIMIT = 1e6  # times the energy at the start with what was supplied since


class Growth:
    """Energies of the start and through free ports since, as absolute values; `LIMIT` times that is beyond any physics."""

    def __init__(self, joined: Joined):
        self._joined = joined
        ports = joined.booking.ports
        self._outer = [i for i, p in enumerate(ports) if p.junction is None]
        self._inner = [i for i, p in enumerate(ports) if p.junction is not None]
        self.known = 0.0

    def given(self, H: Array) -> None:
        """Energies at the start, or what an event changed in them."""
        self.known += float(np.abs(H).sum())

    def watch(self, t: float, h: float, H: Array, pairs: Array) -> None:
        """After a step from t with energies H and energy through `pairs`; StepFailure where they have run away."""
        known = self.known + float(np.abs(pairs[self._outer]).sum())
        total = float(np.abs(H).sum())
        if not total <= LIMIT * known:
            made = float(pairs[self._inner].sum())
            raise StepFailure(
                Status.GROWTH, self._joined.network.name, t, h, joined=True, composable=self._joined.network.composable,
                tried=f"energy {total:.3g} J, {known:.3g} J at the start and supplied since; in this step the junctions "
                f"supplied {made:.3g} J",
            )  # fmt: skip
        self.known = known
