"""The weights of measures of a run as bars of what its rows tell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.tangents import OF_INSTANT, OF_STEP, places
from phfmu.discretise.model import Model
from phfmu.signals import Quantity

Array = NDArray[np.float64]


class RunBars:
    """The weights of measures by row, in the blocks of rows (`OF_STEP`) and of instants (`OF_INSTANT`)."""

    def __init__(self, model: Model, weights: Sequence[dict[Quantity, Array]], times: Sequence[Array | None]):
        step, instant = model.step, model.instant
        self._times = times
        self._weights, self._owner, self._n = weights, step.pair_owner, len(weights)
        self._told = places(("x", *OF_STEP), (step.nx, step.na, step.nq, step.nq, step.ncomp))
        self._instant = places(OF_INSTANT, (instant.na, instant.nq, len(model.observable_names), instant.ncomp))
        self._na, self._nq, self._nobs = step.na, step.nq, len(model.observable_names)

    def of_rows(self, first: int, n: int, total: int) -> tuple[Array, Array | None]:
        """Bars (rows x total x width) of what rows tell, and of what holds at their ends, None for none; those of the measures
        come first, the others are 0."""
        told = np.zeros((n, total, self._told["dissipated"].stop))
        instants = np.zeros((n, total, self._instant["H"].stop))
        for m, weights in enumerate(self._weights):
            for q, c in weights.items():
                own = c[first : first + n]
                entries = np.arange(q.first, q.first + q.count)
                if q.block == "supplied":
                    pairs = np.flatnonzero(np.isin(self._owner, entries))
                    told[:, m, self._told["energy"].start + pairs] += own[:, None]
                elif q.block in self._told:
                    told[:, m, self._told[q.block].start + entries] += own[:, None]
                elif q.block in self._instant:
                    instants[:, m, self._instant[q.block].start + entries] += own[:, None]
        return told, instants if instants.any() else None

    def means_at_start(self, told: Array) -> Array:
        """Means of a row (measures x width of `told`) at a start, or after an event, are values there, of which these are the
        bars."""
        found = np.zeros((len(told), self._instant["H"].stop))
        found[:, self._instant["a_end"]] = told[:, self._told["a"]]
        found[:, self._instant["y_end"]] = told[:, self._told["y_step"]]
        return found

    def in_model(self, bars: Array, model: Model) -> Array:
        """Bars of an instant for a mode, which has rows of its own behind the observables."""
        end, more = self._instant["observables"].stop, model.instant.nobs - self._nobs
        return bars if not more else np.insert(bars, [end] * more, 0.0, axis=-1)

    def energies(self, told: Array) -> tuple[Array, Array]:
        """Bars (measures x ..) of energies through pairs and of those lost, since the start."""
        return told[:, self._told["energy"]], told[:, self._told["dissipated"]]

    def by_time(self, row: int, total: int) -> Array:
        """Bars (total) of the time of a row."""
        found = np.zeros(total)
        found[: self._n] = [0.0 if w is None else w[row] for w in self._times]
        return found

    def of_inputs(self, names: Sequence[str]) -> Array:
        """Derivatives (measures x names) of measures that read held inputs themselves."""
        found = np.zeros((self._n, len(names)))
        for m, weights in enumerate(self._weights):
            for q, c in weights.items():
                if q.block == "input" and q.name in names:
                    found[m, names.index(q.name)] += float(c.sum())
        return found
