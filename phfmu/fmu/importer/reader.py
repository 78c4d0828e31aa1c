"""Instances of units: what a network steps, whether this package or another tool wrote the unit."""

from __future__ import annotations

import weakref
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.fmu.export.manifest import PortMap
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.archive import open_archive
from phfmu.fmu.importer.bindings import able, told
from phfmu.fmu.importer.ports.node_exchange import NodeExchange
from phfmu.fmu.importer.ports.port_values import PortValues
from phfmu.fmu.importer.refusal import UnitCallError, UnitFailure
from phfmu.fmu.importer.unit_books import books
from phfmu.fmu.importer.unit_interface import Scalar, UnitInterface
from phfmu.fmu.importer.unit_steps import SavedState, SavedStates, UnitSteps, free
from phfmu.fmu.importer.values import Derivative, References
from phfmu.fmu.isolation.remote_slave import slave_of
from phfmu.fmu.version import VERSIONS
from phfmu.outcome.status import Status, StepFailure

Array = NDArray[np.float64]


class FMUInstance:
    """A unit a master can step, the twin of `NativeInstance`.

    Inputs u (nu) of all ports in order are held over a step; `output()` gives the means y that belong to
    them, so that h u^T y is the supplied energy: exactly for units with `*_step` outputs, by the trapezoidal
    rule for others (`estimated`).  Power is positive into the component.

    `ports`: only for foreign units.  `starts`: values of parameters, states and inputs before the start.
    `early_return`: `do_step` may end before its end (FMI 3.0), see there.  `isolate`: the unit has a process of its own, in which
    a call may take so many s; UnitFailure if that ends, or is late.  `tolerance`: relative, of the experiment; None leaves it
    to the unit.  `no_set_prior`: what every step is told as noSetFMUStatePriorToCurrentPoint; None tells what is so: that no
    state of a time before it is held.  `in_parts`: each step is taken in two parts, for the means of outputs that the unit tells
    only after a step (see `EstimatedBooks`).
    Errors: FMUError; StepFailure for a refused step: units of this package are back at the last accepted one.
    """

    CARRIED = ("written",)

    def __init__(
        self,
        path: str | Path,
        ports: Sequence[PortMap] | None = None,
        *,
        starts: Mapping[str, float] | None = None,
        start: float | None = None,
        stop: float | None = None,
        name: str | None = None,
        early_return: bool = False,
        isolate: float | None = None,
        tolerance: float | None = None,
        no_set_prior: bool | None = None,
        in_parts: bool = False,
    ):
        archive = open_archive(path)
        self.interface: UnitInterface = archive.interface
        self.name = name or self.interface.name
        self.ports: tuple[PortMap, ...] = self.interface.ports if ports is None else tuple(ports)
        self._values = PortValues(self.interface, self.ports, self.name)
        self.inputs, self.outputs = self._values.inputs, self._values.outputs
        self._books = books(self._values)
        self._starts, self._span = dict(starts or {}), (self.interface.start if start is None else start, stop)
        self._asked: dict[tuple[str, ...], References] = {}
        self._derivative_of: dict[tuple[tuple[str, ...], str], Derivative] = {}
        self.early_return, self._tolerance = early_return, tolerance
        self._slave = slave_of(archive.extracted, self.name, early_return, isolate)
        #: lines about what its library lacks of its version, and what is off for it
        self.lacking = told(self.interface, self._slave.absent)
        self.interface = able(self.interface, self._slave.absent)
        self._states = SavedStates(self._slave)
        #: what steps are told, and how the last one ended
        self.steps = UnitSteps(self.name, self._slave, self._states, self._books, no_set_prior, in_parts)
        #: values at the nodes of a step, impulses, their derivatives: what engines have as methods of their instances
        self.at_nodes = NodeExchange(self._slave, self._values)
        self._close = weakref.finalize(self, free, self._states, archive)
        try:
            self._initialise()
        except BaseException:
            self.close()
            raise

    # -- life -----------------------------------------------------------------------------------------------

    def _initialise(self, given: Mapping[str, float] | None = None, inputs: ArrayLike | None = None) -> None:
        start, stop = self._span
        self._slave.enter(start, stop, self._tolerance)
        if first := self._starts | dict(given or {}):
            self.set(first)
        if inputs is not None:
            self.set_input(inputs)
        self._slave.leave()
        if inputs is None:
            self._values.begin(self._starts)
        self.steps.begin(start)
        self._books.begin(self._slave)

    def close(self) -> None:
        """Free the unit and its saved states; the instance cannot be used afterwards."""
        self._close()

    def __enter__(self) -> FMUInstance:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def reset(self, given: Mapping[str, float] | None = None, inputs: ArrayLike | None = None) -> None:
        """Back to the start values; `given`: values set by name since, `inputs` (nu): of the ports, both before it begins."""
        self._slave.reset()
        self._initialise(given, inputs)

    # -- steps ----------------------------------------------------------------------------------------------

    @property
    def nu(self) -> int:
        """Number of scalar port pairs."""
        return self._values.nu

    @property
    def rated(self) -> bool:
        """Whether all outputs of its ports are rates of displacements that it tells."""
        return len(self._values.rates) == self.nu

    @property
    def estimated(self) -> bool:
        """Whether the ledger is a quadrature of port power, because the unit does not tell its own."""
        return self._books.estimated

    @property
    def dead(self) -> bool:
        """Whether it met a fatal error, after which nothing can be called."""
        return self._slave.dead

    @property
    def time(self) -> float:
        """The present time [s]."""
        return self.steps.time

    @property
    def input_sign(self) -> Array:
        """Times it (nu), a value of a variable counts inward, in units of the domain: -1 where it counts outward in them."""
        return self._values.input_sign

    @property
    def other_inputs(self) -> list[str]:
        """Inputs that belong to no port."""
        return self._values.others()

    @property
    def tunable(self) -> list[str]:
        """Parameters that may be set between steps."""
        variables = self.interface.variables.items()
        return [n for n, v in variables if v.causality == "parameter" and v.variability == "tunable"]

    def start_inputs(self) -> Array:
        """Inputs before anyone sets them."""
        return self._values.starts(self._starts)

    def set_input(self, u: ArrayLike) -> None:
        """Inputs (nu), held over the next steps."""
        self._values.take(u)
        if self.nu:
            self._slave.set(self._values.u)

    @property
    def nodes(self) -> Array:
        """Places on [0, 1] of the nodes at which the unit takes inputs; empty if it takes held ones only."""
        return np.array(self.interface.nodes)

    def set_node_inputs(self, u: ArrayLike) -> None:
        """Inputs at the k nodes of the next step (k x nu), until `set_input`; FMUError if the unit has none."""
        self.at_nodes.set_node_inputs(u)

    def node_output(self) -> Array:
        """Outputs at the k nodes (k x nu): h sum_i b_i u_i^T y_i is the energy supplied, that of impulses aside."""
        return self.at_nodes.node_output()

    def do_step(self, t: float, h: float) -> float:
        """One communication step over [t, t + h]; the time reached.  StepFailure holds the words of the unit.

        The time is t + h unless the unit was made with `early_return`: units of this package then keep the internal steps
        before one that cannot be solved.  Outputs and ledger are those of the step up to there; go on from it.  Where no
        progress is made twice at one time, that is a failure.  One that asks to end the simulation has `steps.ended` after it;
        EndRequested where that is before its end.
        """
        return self.steps.take(t, h)

    def output(self) -> Array:
        """Step-conjugate means of the port outputs (nu)."""
        return self._books.means()

    def end_output(self) -> Array:
        """Port outputs at the present time (nu)."""
        return self._slave.get(self._values.y_end) * self._values.output_sign

    @cached_property
    def _derivatives(self) -> list[Derivative]:
        """Derivatives of the mean outputs, by each input."""
        means, version = self._values.y_mean, VERSIONS[self.interface.version]
        return [] if means is None else [Derivative(means, known, version) for known in self._values.u.scalars]

    def sensitivity(self) -> Array:
        """S = d(mean outputs)/d(held inputs) of the last step (nu x nu).

        StepFailure NO_SENSITIVITY if the unit does not give it: use finite differences.
        """
        if self.estimated or not self.interface.derivatives:
            raise StepFailure(Status.NO_SENSITIVITY, self.name, self.time, self.steps.h)
        s = np.zeros((self.nu, self.nu))
        try:
            for j, d in enumerate(self._derivatives):
                s[:, j] = self._slave.derivative(d)
        except FMUError as error:
            raise StepFailure(Status.NO_SENSITIVITY, self.name, self.time, self.steps.h, tried=str(error)) from error
        return self._values.output_sign[:, None] * s * self._values.input_sign

    def derivatives(self, unknowns: Sequence[str], knowns: Sequence[str]) -> Array:
        """d unknowns / d knowns (unknowns x knowns), as the unit defines them, in its own signs.  FMUError with its words."""
        rows = self._slave.references(self.interface.scalars(list(unknowns), "variable"))
        found = np.zeros((len(unknowns), len(knowns)))
        for j, n in enumerate(knowns if len(unknowns) else ()):
            key = tuple(unknowns), n
            if key not in self._derivative_of:
                self._derivative_of[key] = Derivative(rows, self.variable(n), VERSIONS[self.interface.version])
            found[:, j] = self._slave.derivative(self._derivative_of[key])
        return found

    # -- saved states ---------------------------------------------------------------------------------------

    def get_state(self) -> SavedState:
        """A complete copy; stepping after `set_state` gives the same bits.  FMUError if there is none."""
        if not self.interface.saves:
            raise FMUError(
                f"{self.name}: the unit cannot save its state, which couplings need that repeat steps; step it last "
                "(phfmu.network.members.unit_member), take --coupling gauss-seidel, or export it with saved states"
            )
        memory = {"time": self.time, "h": self.steps.h, "values": self._values.memory(), "books": self._books.memory()}
        return self._states.keep(self._slave.save(), memory)

    def set_state(self, state: SavedState) -> None:
        """Restores what `get_state` gave."""
        self._slave.restore(state.handle)
        self.steps.time, self.steps.h = state.memory["time"], state.memory["h"]
        self._values.recall(state.memory["values"])
        self._books.recall(state.memory["books"])

    def serialize(self, state: SavedState) -> bytes:
        """The state as bytes, for another instance of the same unit, also in another process."""
        return self._slave.serialize(state.handle)

    def deserialize(self, data: bytes, like: SavedState) -> SavedState:
        """A state of this instance from bytes; `like` gives what the instance knows beside the unit."""
        return self._states.keep(self._slave.deserialize(data), dict(like.memory))

    @property
    def written(self) -> tuple[bytes, dict[str, Any]]:
        """Its state as bytes, and what the instance knows beside it: what another instance goes on from when it is set there."""
        state = self.get_state()
        return self.serialize(state), state.memory

    @written.setter
    def written(self, found: tuple[bytes, dict[str, Any]]) -> None:
        data, memory = found
        self.set_state(self._states.keep(self._slave.deserialize(data), memory))

    # -- reading --------------------------------------------------------------------------------------------

    @property
    def names(self) -> list[str]:
        """Variables that may change during a run: inputs, outputs and local variables, but those at the nodes of a step."""
        left, kinds = self._values.of_steps(), ("input", "output", "local")
        return [n for n, v in self.interface.variables.items() if v.causality in kinds and n not in left]

    def variable(self, name: str) -> Scalar:
        """The variable as the unit describes it."""
        return self.interface.scalars([name], "variable")[0]

    def get(self, names: Iterable[str]) -> Array:
        """Values at the present time; the places of a group of names are looked up once."""
        asked = tuple(names)
        known = self._asked.get(asked)
        if known is None:
            known = self._asked[asked] = self._slave.references(self.interface.scalars(asked, "variable"))
        try:
            return self._slave.get(known).copy()
        except UnitCallError as error:
            if self.estimated and self.steps.h:
                raise UnitFailure(self.name, self.time, 0.0, error.function, error.answer, error.words) from error
            raise

    def set(self, values: Mapping[str, float]) -> None:
        """Values by name: start values before the first step, inputs outside of ports and tunable parameters at any time."""
        r = self._slave.references(self.interface.scalars(list(values), "variable"))
        r.values[:] = list(values.values())
        try:
            self._slave.set(r)
        except UnitCallError:
            raise
        except FMUError as error:
            raise FMUError(f"{self.name}: {error}") from None

    def values(self) -> dict[str, float]:
        """All variables of `names`."""
        names = self.names
        return dict(zip(names, self.get(names).tolist(), strict=True))

    def energies(self) -> Array:
        """Stored energy (1); of an estimated unit, what was supplied since the start."""
        return self._books.energies()

    def gap(self) -> float | None:
        """H - H(start) - sum of stored [J]: what the ledger of the unit cannot explain; None if it does not tell."""
        return self._books.gap()

    def ledger(self) -> dict[str, Array]:
        """Ledger of the last step: stored, dissipated, supplied (1 each) and energy through each pair (nu) [J].

        `moved` (1), the sum over its energies of |change|, is there if the unit tells it; what cannot close is small to it.
        An estimated unit keeps to itself what it dissipates: stored is what was supplied.
        """
        return self._books.ledger(self.steps.h)
