"""Growth without bound of coupled members: of their energy, and of signals between them, where no energy tells it.

Energy has run away beyond `ENERGY_LIMIT` times all that members had and were given.  A loop of signals that the coupling makes
unstable grows by a factor per step: each doubling takes as long as the one before, while those of t^p take 2^(1/p) times as
long.  Doublings to `SIGNAL_LIMIT` times the size, `FEWEST` at least since a signal may jump, of which the second half took no
longer than `STEADY` times the first one, are told.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.members.predicted_member import POOR
from phfmu.network.wires import Wire
from phfmu.outcome.status import Status, StepFailure

Array = NDArray[np.float64]

ENERGY_LIMIT = 1e6  # times the energy at the start with what was supplied since
SIGNAL_LIMIT = 1e6  # times the size of a signal when its doublings began
FEWEST, MOST = 12, 20  # doublings of a signal
STEADY = 1.5  # times the first half of the doublings that the second half may take


class EnergyGrowth:
    """Energies of the start and through free ports since, as absolute values; `ENERGY_LIMIT` times that is beyond any physics.

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
        away = ~(np.abs(H).sum(axis=1) <= ENERGY_LIMIT * known)
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
        if not total <= ENERGY_LIMIT * known_here and (known_here or not any(self._estimated)):
            made = float(pairs[self._inner].sum())
            raise StepFailure(
                Status.GROWTH, self._joined.network.name, t, h, joined=True, composable=self._joined.network.composable,
                put_off=", ".join(m.name for m in self._joined.put_off),
                tried=f"energy {total:.3g} J, {known_here:.3g} J at the start and supplied since; in this step the junctions "
                f"supplied {made:.3g} J",
            )  # fmt: skip
        self.known = known


class SignalGrowth:
    """Growth of held signals, step after step."""

    CARRIED = ("_level", "_when", "told")

    def __init__(self, wires: Sequence[Wire]):
        self._wires = wires
        self._level = np.zeros(len(wires))
        #: of each signal when it doubled last, and to what
        self._when = [deque[tuple[float, float]](maxlen=MOST + 1) for _ in wires]
        #: lines about signals that have grown
        self.told: dict[int, str] = {}

    def watch(self, t: float, values: Array) -> None:
        """The signals at time t."""
        size = np.abs(values)
        for i in np.flatnonzero(size > 2.0 * self._level):
            when, i = self._when[i], int(i)
            self._level[i] = size[i]
            when.append((t, float(size[i])))
            if i not in self.told and _steady(when):
                start, before = when[0]
                self.told[i] = (
                    f"signal {self._wires[i]} grows without bound: {size[i]:.3g} at t = {t:.6g} s, {before:.3g} at "
                    f"t = {start:.6g} s; a loop of signals that are held over steps may be unstable: take a smaller step, or "
                    "--coupling newton without --signals-held, which iterates them where units can take steps back"
                )


def _steady(when: Sequence[tuple[float, float]]) -> bool:
    if len(when) <= FEWEST or when[-1][1] < SIGNAL_LIMIT * when[0][1]:
        return False
    start, middle, end = when[0][0], when[len(when) // 2][0], when[-1][0]
    return end - middle <= STEADY * (middle - start)
