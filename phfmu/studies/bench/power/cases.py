"""The circuits that are compared with DPsim, with their errors and the settings of both."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model
from phfmu.network.network import Network
from phfmu.studies.bench.power import circuit, dpsim, own
from phfmu.studies.bench.power.kundur import Kundur
from phfmu.studies.bench.precision.candidate import Candidate, CandidateRun, Solve, missing
from phfmu.studies.bench.precision.problem import SolutionErrors

Array = NDArray[np.float64]
#: rows are compared at multiples of this [s], of which every step is a part
EVERY = 1e-3
#: time at which a fault that clears does, and the end of the nine buses' run [s]
CLEARS, NINE_STOP = 0.15, 0.3


@dataclass(eq=False)
class GridCase:
    """A network as DPsim takes it and as it is declared; rows at multiples of EVERY are judged against a reference.

    columns: of our run, whose values relative to `scale` are compared;  models: of DPsim with their steps [s]
    read: rows of DPsim -> the same quantities in units of `unit`
    """

    name: str
    declared: Callable[[], Network]
    net: dict[str, Any]
    columns: tuple[str, ...]
    judged: tuple[str, ...]
    steps: dict[int, tuple[float, ...]]
    models: dict[str, tuple[float, ...]]
    read: Callable[[str, Array], Array]
    reference: Array
    scale: float
    unit: Array | float = 1.0

    @property
    def stop(self) -> float:
        return self.net["stop"]

    @property
    def times(self) -> tuple[float, ...]:
        return (self.stop,)

    @property
    def grid(self) -> Array:
        return np.array([self.stop])

    def judge(self, x: Array) -> SolutionErrors:
        """`x`: rows from EVERY on; the largest difference relative to the scale."""
        n = min(len(x), len(self.reference))
        return SolutionErrors(
            (float(np.abs(x[:n] - self.reference[:n]).max()) / self.scale,), float("nan"), float("nan")
        )

    def candidates(self) -> Iterator[Candidate]:
        network = self.declared()
        for order, steps in self.steps.items():
            model = own.planned(network, order)
            for h in steps:
                yield Candidate(
                    f"phfmu, order {order}", f"h={1e6 * h:g} us", h,
                    lambda m=model, h=h: self._own(m, h), own=True,
                )  # fmt: skip
        if why := dpsim.obstacle():
            yield missing("DPsim", why)
            return
        for model, steps in self.models.items():
            for h in steps:
                yield Candidate(f"DPsim {model}", f"h={1e6 * h:g} us", h, lambda m=model, h=h: self._dpsim(m, h))

    def _own(self, model: Model, h: float) -> Solve:
        solve = own.FixedStepNetwork(model, self.columns, h, self.net, EVERY)

        def read(times: Sequence[float], watch: bool = False) -> CandidateRun:
            run = solve(times, watch)
            return replace(run, x=run.x / self.unit) if watch else run

        return read

    def _dpsim(self, model: str, h: float) -> Solve:
        net = self.net | {"model": model}

        def solve(times: Sequence[float], watch: bool = False) -> CandidateRun:
            found = dpsim.run(net, h, log=watch, every=EVERY)
            rows = self.read(model, np.array(found.get("rows", [])))
            return CandidateRun(rows, round(self.stop / h), cpu=found["cpu"])

        return solve


def currents(model: str, rows: Array) -> Array:
    """Currents into the machine from EVERY on; the reduced models count them out of it."""
    if not len(rows):
        return rows
    return rows[1:, :3] if model == dpsim.FULL else -rows[:, :3]


US = 1e-6
STEPS = {2: (200 * US, 50 * US, 20 * US), 4: (200 * US, 100 * US, 50 * US), 6: (200 * US, 50 * US)}
DPSIM = {dpsim.FULL: (100 * US, 50 * US, 20 * US, 5 * US), dpsim.FOURTH: (50 * US,)}


def smib(t_clear: float, name: str) -> GridCase:
    """One machine; currents relative to their largest."""
    times = EVERY * np.arange(1, round(circuit.STOP / EVERY) + 1, dtype=np.float64)
    exact = Kundur().currents(times, t_clear)
    columns = tuple(f"gen.I[{k}]" for k in (1, 2, 3))
    return GridCase(
        name, own.smib, dpsim.smib(dpsim.FULL, t_clear), columns, ("stator current",), STEPS, DPSIM, currents, exact,
        float(np.abs(exact).max()),
    )  # fmt: skip


def stays() -> GridCase:
    return smib(circuit.STOP, "smib, fault stays")


def clears() -> GridCase:
    return smib(CLEARS, "smib, fault clears")


def speeds(model: str, rows: Array) -> Array:
    """Speeds of the three machines in per unit from EVERY on."""
    return rows[:, -3:] if len(rows) else rows


def nine_buses(t_clear: float, name: str) -> GridCase:
    """Three machines; speeds relative to the largest deviation, against order 6 in steps of 50 us.

    DPsim's machines are of order 4, without dampers of their own and without transients of the stator: its distance is that of
    the models.
    """
    net = dpsim.nine_buses(t_clear, NINE_STOP)
    columns = tuple(f"gen{k}.p" for k in (1, 2, 3))
    declared = own.nine_buses()
    model = own.planned(declared, 6)
    momenta = own.FixedStepNetwork(model, columns, 50 * US, net, EVERY)([NINE_STOP], watch=True).x
    at_start = np.array([own.start_of(model, n) for n in columns])
    exact = momenta / at_start
    steps = {2: (200 * US, 50 * US), 4: (200 * US, 50 * US)}
    models = {dpsim.FOURTH: (200 * US, 50 * US)}
    return GridCase(
        name,
        own.nine_buses,
        net,
        columns,
        ("speed",),
        steps,
        models,
        speeds,
        exact,
        float(np.abs(exact - 1).max()),
        at_start,
    )


def nine_stay() -> GridCase:
    return nine_buses(NINE_STOP, "wscc9, fault stays")


def nine_clear() -> GridCase:
    return nine_buses(CLEARS, "wscc9, fault clears")


CASES: dict[str, Callable[[], GridCase]] = {
    "smib, fault stays": stays,
    "smib, fault clears": clears,
    "wscc9, fault stays": nine_stay,
    "wscc9, fault clears": nine_clear,
}
