"""Instances of units: what a network steps, whether this package or another tool wrote the unit."""

from __future__ import annotations

import weakref
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.engine.status import Status, StepFailure
from phfmu.fmu.archive import open_archive
from phfmu.fmu.interface import Interface, Scalar
from phfmu.fmu.manifest import PortMap
from phfmu.fmu.refusal import UnitCallError, UnitFailure
from phfmu.fmu.slave import Slave
from phfmu.fmu.values import Derivative, References
from phfmu.fmu.variables import FMUError
from phfmu.fmu.version import VERSIONS

Array = NDArray[np.float64]
_STEP, _MOVED = ("storedStep", "dissipatedStep", "suppliedStep"), "movedStep"


@dataclass(eq=False)
class SavedState:
    """A state inside the unit and what the instance knows beside it; freed when nobody holds it."""

    handle: Any
    memory: dict[str, Any]


class FMUInstance:
    """A unit a master can step, the twin of `NativeInstance`.

    Inputs u (nu) of all ports in order are held over a step; `output()` gives the means y that belong to
    them, so that h u^T y is the supplied energy: exactly for units with `*_step` outputs, by the trapezoidal
    rule for others (`estimated`).  Power is positive into the component.

    `ports`: only for foreign units.  `starts`: values of parameters, states and inputs before the start.
    `early_return`: `do_step` may end before its end (FMI 3.0), see there.
    Errors: FMUError; StepFailure for a refused step: units of this package are back at the last accepted one.
    """

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
    ):
        archive = open_archive(path)
        self.interface: Interface = archive.interface
        self.name = name or self.interface.name
        self.ports: tuple[PortMap, ...] = self.interface.ports if ports is None else tuple(ports)
        self.inputs = [n for p in self.ports for n in p.inputs]
        self.outputs = [n for p in self.ports for n in p.outputs]
        means = [n for p in self.ports for n in p.step_outputs]
        #: the ledger is a quadrature of port power, because the unit does not tell its own
        self.estimated = len(means) != len(self.inputs) or not all(s in self.interface.energy for s in _STEP)
        self._sign = np.array([p.sign for p in self.ports for _ in p.inputs])
        version, scalars = VERSIONS[self.interface.version], self.interface.scalars

        def group(names: list[str], what: str) -> References:
            return References(scalars(names, what), version)

        self._u = group(self.inputs, "input")
        self._y_end = group(self.outputs, "output")
        self._y_mean = self._y_end if self.estimated else group(means, "output")
        told = () if self.estimated else (*_STEP, *(s for s in (_MOVED,) if s in self.interface.energy))
        self._books = group([self.interface.energy[s] for s in told], "output")
        self._u_nodes = group(_in_order(self.ports, "node_inputs"), "input")
        self._y_nodes = group(_in_order(self.ports, "node_outputs"), "output")
        self._require_pairs()
        self._starts, self._span = (
            dict(starts or {}),
            (self.interface.start if start is None else start, stop),
        )
        self._asked: dict[tuple[str, ...], References] = {}
        self.early_return = early_return
        self._slave = Slave(archive, self.name, early_return)
        self._handles: dict[int, Any] = {}
        self._close = weakref.finalize(self, _free, self._slave, self._handles, archive)
        try:
            self._initialise()
        except BaseException:
            self.close()
            raise

    def _require_pairs(self) -> None:
        for p in self.ports:
            if len(p.inputs) != len(p.outputs):
                raise FMUError(f"{self.name}.{p.name}: {len(p.inputs)} inputs but {len(p.outputs)} outputs; give pairs")
        for n in self.inputs:
            if self.interface.variables[n].causality != "input":
                raise FMUError(f"{self.name}: '{n}' is no input but {self.interface.variables[n].causality}")

    # -- life -----------------------------------------------------------------------------------------------

    def _initialise(self) -> None:
        start, stop = self._span
        self._slave.enter(start, stop)
        if self._starts:
            self.set(self._starts)
        self._slave.leave()
        self._u.values[:] = self.start_inputs()
        self.time, self._h = start, 0.0
        self._supplied = np.zeros(self.nu)
        self._pairs = np.zeros(self.nu)
        self._held = True
        self._before = self._after = self._slave.get(self._y_end).copy() if self.estimated else np.zeros(0)

    def close(self) -> None:
        """Free the unit and its saved states; the instance cannot be used afterwards."""
        self._close()

    def __enter__(self) -> FMUInstance:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def reset(self) -> None:
        """Back to the start values."""
        self._slave.reset()
        self._initialise()

    # -- steps ----------------------------------------------------------------------------------------------

    @property
    def nu(self) -> int:
        """Number of scalar port pairs."""
        return self._u.n

    @property
    def dead(self) -> bool:
        """Whether it met a fatal error, after which nothing can be called."""
        return self._slave.dead

    @property
    def other_inputs(self) -> list[str]:
        """Inputs that belong to no port."""
        own = {*self.inputs, *_in_order(self.ports, "node_inputs")}
        return [n for n, v in self.interface.variables.items() if v.causality == "input" and n not in own]

    def start_inputs(self) -> Array:
        """Inputs before anyone sets them."""
        declared = [self.interface.variables[n].start or 0.0 for n in self.inputs]
        return np.array([self._starts.get(n, s) for n, s in zip(self.inputs, declared, strict=True)])

    def set_input(self, u: ArrayLike) -> None:
        """Inputs (nu), held over the next steps."""
        values = np.asarray(u, float)
        if values.shape != (self.nu,) or not np.isfinite(values).all():
            raise ValueError(f"{self.name}: expected {self.nu} finite inputs, got {u}")
        self._u.values[:] = values
        self._held = True
        if self.nu:
            self._slave.set(self._u)

    @property
    def nodes(self) -> Array:
        """Places on [0, 1] of the nodes at which the unit takes inputs; empty if it takes held ones only."""
        return np.array(self.interface.nodes)

    def set_node_inputs(self, u: ArrayLike) -> None:
        """Inputs at the k nodes of the next step (k x nu); the next `set_input` holds its values again.

        FMUError if the unit was exported without them.
        """
        values, k = np.asarray(u, float), len(self.interface.nodes) if self._u_nodes.n else 0
        if not k:
            raise FMUError(
                f"{self.name}: the unit has no inputs at nodes; export it with --node-inputs and order 4 or 6"
            )
        if values.shape != (k, self.nu) or not np.isfinite(values).all():
            raise ValueError(f"{self.name}: expected {k} x {self.nu} finite inputs, got {u}")
        self._u_nodes.values[:] = values.ravel()
        self._held = False
        if self.nu:
            self._slave.set(self._u_nodes)

    def node_output(self) -> Array:
        """Outputs at the k nodes (k x nu): h sum_i b_i u_i^T y_i is the supplied energy of the last step."""
        return self._slave.get(self._y_nodes).reshape(-1, self.nu).copy()

    def do_step(self, t: float, h: float) -> float:
        """One communication step over [t, t + h]; the time reached.  StepFailure holds the words of the unit.

        The time is t + h unless the unit was made with `early_return`: units of this package then keep the internal steps
        before one that cannot be solved.  Outputs and ledger are those of the step up to there; go on from it.
        """
        try:
            reached = self._slave.do_step(t, h)
            after = self._slave.get(self._y_end).copy() if self.estimated else self._after
        except UnitCallError as error:
            status = None if self.estimated else error.status
            if status is None:  # its words and no remedy of ours
                raise UnitFailure(self.name, t, h, error.function, error.answer, error.words) from error
            raise StepFailure(status, self.name, t, h, tried=f"in the unit: {error}") from error
        if not np.isfinite(after).all():
            raise self.not_finite(self.outputs, after, reached)
        self.time, self._h = reached, h if reached == t + h else reached - t
        if self.estimated:
            self._before, self._after = self._after, after
            self._pairs = self._h * self._u.values * self.output()
            self._supplied = self._supplied + self._pairs
        return reached

    def not_finite(self, names: Sequence[str], values: Array, t: float) -> UnitFailure:
        """The failure that names the first of the variables whose value at time t is not finite."""
        i = int(np.argmin(np.isfinite(values)))
        return UnitFailure(self.name, t, 0.0, f"'{names[i]}' = {values[i]}", "not finite", list(self._slave.words)[-1:])

    def output(self) -> Array:
        """Step-conjugate means of the port outputs (nu)."""
        if self.estimated:
            return self._sign * (self._before + self._after) / 2
        return self._slave.get(self._y_mean) * self._sign

    def end_output(self) -> Array:
        """Port outputs at the present time (nu)."""
        return self._slave.get(self._y_end) * self._sign

    @cached_property
    def _derivatives(self) -> list[Derivative]:
        """Of the mean outputs, by each input."""
        version = VERSIONS[self.interface.version]
        return [Derivative(self._y_mean, known, version) for known in self._u.scalars]

    def sensitivity(self) -> Array:
        """S = d(mean outputs)/d(held inputs) of the last step (nu x nu).

        StepFailure NO_SENSITIVITY if the unit does not give it: use finite differences.
        """
        if self.estimated or not self.interface.derivatives:
            raise StepFailure(Status.NO_SENSITIVITY, self.name, self.time, self._h)
        s = np.zeros((self.nu, self.nu))
        try:
            for j, d in enumerate(self._derivatives):
                s[:, j] = self._slave.derivative(d)
        except FMUError as error:
            raise StepFailure(Status.NO_SENSITIVITY, self.name, self.time, self._h, tried=str(error)) from error
        return s

    # -- saved states ---------------------------------------------------------------------------------------

    def get_state(self) -> SavedState:
        """A complete copy; stepping after `set_state` gives the same bits.  FMUError if there is none."""
        if not self.interface.saves:
            raise FMUError(
                f"{self.name}: the unit cannot save its state, which coupled steps need because they are repeated; run it "
                "alone, or export it with saved states (canGetAndSetFMUstate)"
            )
        handle = self._slave.save()
        return self._kept(handle)

    def _kept(self, handle: Any) -> SavedState:
        memory = {n: np.copy(getattr(self, n)) for n in ("_before", "_after", "_supplied", "_pairs")}
        memory |= {"time": self.time, "_h": self._h, "_held": self._held}
        memory |= {"_u": self._u.values.copy(), "_u_nodes": self._u_nodes.values.copy()}
        state = SavedState(handle, memory)
        self._handles[id(handle)] = handle
        weakref.finalize(state, _forget, self._slave, self._handles, id(handle))
        return state

    def set_state(self, state: SavedState) -> None:
        """Restores what `get_state` gave."""
        self._slave.restore(state.handle)
        for name, value in state.memory.items():
            if name in ("_u", "_u_nodes"):
                getattr(self, name).values[:] = value
            else:
                setattr(self, name, value.copy() if isinstance(value, np.ndarray) else value)

    def serialize(self, state: SavedState) -> bytes:
        """The state as bytes, for another instance of the same unit, also in another process."""
        return self._slave.serialize(state.handle)

    def deserialize(self, data: bytes, like: SavedState) -> SavedState:
        """A state of this instance from bytes; `like` gives what the instance knows beside the unit."""
        state = self._kept(self._slave.deserialize(data))
        state.memory = dict(like.memory)
        return state

    # -- reading --------------------------------------------------------------------------------------------

    @property
    def names(self) -> list[str]:
        """Variables that may change during a run: inputs, outputs and local variables."""
        return [n for n, v in self.interface.variables.items() if v.causality in ("input", "output", "local")]

    def variable(self, name: str) -> Scalar:
        """What the unit says about a variable."""
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
            if self.estimated and self._h:
                raise UnitFailure(self.name, self.time, 0.0, error.function, error.answer, error.words) from error
            raise

    def set(self, values: Mapping[str, float]) -> None:
        """Values by name: start values before the first step, inputs outside of ports at any time."""
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
        if self.estimated:
            return np.array([self._supplied.sum()])
        return self.get([self.interface.energy["stored"]])

    def gap(self) -> float | None:
        """H - H(start) - sum of stored [J]: what the ledger of the unit cannot explain; None if it does not tell."""
        name = None if self.estimated else self.interface.energy.get("gap")
        return None if name is None else float(self.get([name])[0])

    def ledger(self) -> dict[str, Array]:
        """Of the last step: stored, dissipated, supplied (1 each) and energy through each pair (nu) [J].

        `moved` (1), the sum over its energies of |change|, is there if the unit tells it; what cannot close is small to it.
        An estimated unit keeps to itself what it dissipates: stored is what was supplied.
        """
        if self.estimated:
            supplied = np.array([self._pairs.sum()])
            return {
                "stored": supplied,
                "dissipated": np.zeros(1),
                "supplied": supplied,
                "pairs": self._pairs.copy(),
            }
        books = self._slave.get(self._books).copy()
        if self._held:
            pairs = self._h * self._u.values * self.output()
        else:
            u = self._u_nodes.values.reshape(-1, self.nu)
            pairs = self._h * np.array(self.interface.weights) @ (u * self.node_output())
        moved = {"moved": books[3:]} if len(books) > len(_STEP) else {}
        return {"stored": books[:1], "dissipated": books[1:2], "supplied": books[2:3], "pairs": pairs, **moved}


def _in_order(ports: Sequence[PortMap], field: str) -> list[str]:
    """Names at the nodes, node by node, in the order of the pairs."""
    pairs = [names for p in ports for names in getattr(p, field)]
    return [name for node in zip(*pairs, strict=True) for name in node]


def _forget(slave: Slave, handles: dict[int, Any], key: int) -> None:
    handle = handles.pop(key, None)
    if handle is not None:
        slave.forget(handle)


def _free(slave: Slave, handles: dict[int, Any], archive: object) -> None:
    """`archive` is held so that its folder outlives the library."""
    for key in list(handles):
        _forget(slave, handles, key)
    slave.free()
