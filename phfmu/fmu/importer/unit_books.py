"""Books of a unit's energy: what it tells of its own ledger, or an estimate by the power of its ports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from phfmu.fmu.importer.ports.port_values import PortValues
from phfmu.fmu.importer.slave import AnySlave
from phfmu.fmu.importer.values import References

Array = NDArray[np.float64]
#: of an estimate, what a saved state keeps
_KEPT = ("after", "means", "supplied", "pairs")
_STEP, _MOVED = ("storedStep", "dissipatedStep", "suppliedStep"), "movedStep"


class Books(Protocol):
    """The interface of an instance to its books: `begin` at the start; after a step `look`, then `book` with what that gave."""

    #: the ledger is a quadrature of port power, because the unit does not tell its own
    estimated: bool
    #: the variables that `look` gives
    looked: Sequence[str]

    def begin(self, slave: AnySlave) -> None: ...

    def ahead(self) -> None:
        """Before a step, whose inputs are set."""
        ...

    def within(self, looked: Array) -> None:
        """At a third of a step that is taken in two parts, what `look` gave there."""
        ...

    def look(self) -> Array:
        """Outputs that are needed to book a step; they have to be finite."""
        ...

    def book(self, h: float, looked: Array) -> None: ...

    def means(self) -> Array:
        """Outputs (nu) of which h u^T y is the energy supplied in the last step."""
        ...

    def energies(self) -> Array:
        """Stored energy (1) [J]."""
        ...

    def gap(self) -> float | None:
        """Energy that the ledgers of the steps do not explain [J]; None if that is not told."""
        ...

    def ledger(self, h: float) -> dict[str, Array]:
        """Ledger of the last step, of length h."""
        ...

    def memory(self) -> dict[str, Any]:
        """A copy of what the unit does not save itself."""
        ...

    def recall(self, memory: Mapping[str, Any]) -> None: ...


def books(ports: PortValues) -> Books:
    """The unit's own where it tells enough."""
    means, told = ports.y_mean, ports.interface.energy
    return EstimatedBooks(ports) if means is None or not {*_STEP, "stored"} <= told.keys() else OwnBooks(ports, means)


class OwnBooks:
    """The unit's own ledger, exact; kept here are the inputs of the last step, at nodes or held."""

    estimated = False
    looked: Sequence[str] = ()

    def __init__(self, ports: PortValues, means: References):
        self._ports, self._means, energy = ports, means, ports.interface.energy
        self.step = ports.group([energy[s] for s in (*_STEP, _MOVED) if s in energy], "output")
        self.stored = ports.group([energy["stored"]], "output")
        self._gap = ports.group([energy["gap"]], "output") if "gap" in energy else None

    def begin(self, slave: AnySlave) -> None:
        self._slave = slave
        self._given = self._ports.given()

    def ahead(self) -> None: ...

    def within(self, looked: Array) -> None: ...

    def look(self) -> Array:
        return np.zeros(0)

    def book(self, h: float, looked: Array) -> None:
        self._given = self._ports.given()

    def means(self) -> Array:
        return self._slave.get(self._means) * self._ports.output_sign

    def energies(self) -> Array:
        return self._slave.get(self.stored).copy()

    def gap(self) -> float | None:
        return None if self._gap is None else float(self._slave.get(self._gap)[0])

    def ledger(self, h: float) -> dict[str, Array]:
        rows, ports = self._slave.get(self.step).copy(), self._ports
        if ports.pair_energies.n:
            pairs = self._slave.get(ports.pair_energies).copy()
        elif len(self._given) == 1:
            pairs = self.through(h, self._given, self.means()[None])
        else:
            y = self._slave.get(ports.y_nodes).reshape(-1, ports.nu) * ports.output_sign
            pairs = self.through(h, self._given, y)
        return self.named(rows) | {"pairs": pairs}

    def through(self, h: float, given: Array, y: Array) -> Array:
        """Energy through each pair in steps of length h (.. x nu) of inputs and outputs at nodes, or held ones (.. x k x nu)."""
        if given.shape[-2] == 1:
            return h * given[..., 0, :] * y[..., 0, :]
        return h * np.array(self._ports.interface.weights) @ (given * y)

    @staticmethod
    def named(step: Array) -> dict[str, Array]:
        """Values of `step` (.. x n) by what they are."""
        moved = {"moved": step[..., 3:]} if step.shape[-1] > len(_STEP) else {}
        return {"stored": step[..., :1], "dissipated": step[..., 1:2], "supplied": step[..., 2:3], **moved}

    def memory(self) -> dict[str, Any]:
        return {"given": self._given}

    def recall(self, memory: Mapping[str, Any]) -> None:
        self._given = memory["given"]


class EstimatedBooks:
    """Books by the change of displacements, whose rates the outputs are: u (q1 - q0) is what held inputs supply; else by the
    trapezoid of the outputs under its inputs, (y(t) + y(t + h)) / 2.

    A unit that tells outputs which follow its inputs at once only after a step (`rollback.tells_late`) has none at the start of a
    step that belong to it. Its steps are taken in two parts, and the mean is that of Radau's rule, 3/4 y(t + h/3) + 1/4 y(t + h),
    exact for outputs that are quadratic in time.

    What the unit dissipates it keeps to itself: stored is what was supplied.
    """

    estimated = True

    def __init__(self, ports: PortValues):
        self._ports, n = ports, ports.nu
        self.looked: Sequence[str] = [*ports.outputs, *ports.displacements]
        self._seen = ports.group(self.looked, "output")
        self._inward = np.concatenate([ports.output_sign, ports.displacement_sign])
        self._rates = ports.rates
        self._y, self._q = slice(0, n), slice(n, None)

    def begin(self, slave: AnySlave) -> None:
        self._slave = slave
        self._third: Array | None = None
        self._supplied, self._pairs = np.zeros(self._ports.nu), np.zeros(self._ports.nu)
        self._after = self.look() * self._inward
        self._means = self._after[self._y]

    def ahead(self) -> None:
        """Outputs at the start of a step are those under its own inputs, as far as the unit follows these at once."""
        self._after, self._third = self.look() * self._inward, None

    def within(self, looked: Array) -> None:
        self._third = (looked * self._inward)[self._y]

    def look(self) -> Array:
        return self._slave.get(self._seen).copy()

    def book(self, h: float, looked: Array) -> None:
        before, after = self._after, looked * self._inward
        end, third = after[self._y], self._third
        means = (before[self._y] + end) / 2 if third is None else 0.75 * third + 0.25 * end
        if h:
            means[self._rates] = (after[self._q] - before[self._q]) / h
        self._after, self._means = after, means
        self._pairs = h * self._ports.inputs_now() * means
        self._supplied = self._supplied + self._pairs

    def means(self) -> Array:
        return self._means.copy()

    def energies(self) -> Array:
        return np.array([self._supplied.sum()])

    def gap(self) -> float | None:
        return None

    def ledger(self, h: float) -> dict[str, Array]:
        del h
        supplied = np.array([self._pairs.sum()])
        return {"stored": supplied, "dissipated": np.zeros(1), "supplied": supplied, "pairs": self._pairs.copy()}

    def memory(self) -> dict[str, Any]:
        return {n: getattr(self, f"_{n}").copy() for n in _KEPT}

    def recall(self, memory: Mapping[str, Any]) -> None:
        for n in _KEPT:
            setattr(self, f"_{n}", memory[n].copy())
