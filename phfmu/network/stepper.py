"""Steppers: what the run loop drives, whether one composed model or coupled members."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model, build_model
from phfmu.engine.status import StepFailure
from phfmu.fmu.variables import ordered_ports
from phfmu.network.columns import Columns
from phfmu.schemes.scheme import Scheme

if TYPE_CHECKING:
    from phfmu.discretise.start import Projection
    from phfmu.network.dense import Dense

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Steps:
    """n accepted steps: columns of `signals` as the stepper's `names`; ledger per component and scalar port pair."""

    signals: Array
    H: Array
    stored: Array
    dissipated: Array
    supplied: Array
    pairs: Array
    iterations: Array
    #: lost by a damping scheme (n x components), None where there is none
    numerical: Array | None = None
    #: sum over the energies of a component of |change| (n x components), None where only their sum is known
    moved: Array | None = None
    #: rows within each step (n x rows x names), None unless asked for
    between: Array | None = None

    @classmethod
    def stacked(cls, rows: list[tuple[Array, ...]]) -> Steps:
        """From one tuple of values per step, in the order of the fields."""
        return cls(*(np.array(column) for column in zip(*rows, strict=True)))

    @classmethod
    def joined(cls, parts: list[Steps]) -> Steps:
        """One after the other; a part without numerical loss has 0 where others have one."""
        names = ("signals", "H", "stored", "dissipated", "supplied", "pairs", "iterations")
        arrays = {n: np.concatenate([getattr(p, n) for p in parts]) for n in names}
        moved = [p.moved for p in parts if p.moved is not None]
        lossy = any(p.numerical is not None for p in parts)
        lost = [np.zeros_like(p.H) if p.numerical is None else p.numerical for p in parts]
        between = (
            None if parts[0].between is None else np.concatenate([p.between for p in parts if p.between is not None])
        )
        return cls(
            **arrays, numerical=np.concatenate(lost) if lossy else None,
            moved=np.concatenate(moved) if len(moved) == len(parts) else None, between=between,
        )  # fmt: skip


@dataclass(frozen=True)
class Booking:
    """What the audit calls the ledger columns: component names, and per pair (component, port, index, junction)."""

    components: tuple[str, ...]
    pairs: tuple[tuple[str, str, int | None, str | None], ...]
    #: components whose ledger is a quadrature of port power (foreign FMUs): it closes by construction
    estimated: frozenset[str] = frozenset()


class Stepper(Protocol):
    """Drives a system through n steps, numbers first..first+n-1 of the grid t0 + k h.

    When a step fails, the state is that of the last accepted one and StepFailure.recorded["steps"] holds those before.
    """

    names: list[str]
    booking: Booking
    #: what it is, and how to get one composed model instead; for messages
    what: str
    instead: str

    def settable(self) -> list[str]: ...
    def set_value(self, name: str, value: float) -> str: ...
    def read(self) -> Array: ...
    def energies(self) -> Array: ...
    def check_start(self) -> None: ...
    def project_start(self, t0: float, kept: Sequence[str] = ()) -> Projection | None: ...
    def advance(self, t0: float, h: float, n: int, first: int = 0) -> Steps: ...


class InconsistentState(ValueError):
    """A hidden constraint (position, velocity, Kirchhoff) does not hold; names it with its number and remedy."""


@dataclass
class Inputs:
    """Named parameters and inputs of one instance, set one at a time."""

    instance: Any
    model: Model
    parameters: dict[str, int] = field(init=False)
    inputs: dict[str, int] = field(init=False)

    def __post_init__(self) -> None:
        d = self.model.declaration
        names = [n for v in d.parameters for n in v.names()]
        self.parameters = {n: i for i, n in enumerate(names)}
        free = [n for p in d.ports if p.external for n in p.input_names()]
        self.inputs = {n: i for i, n in enumerate(free)}
        self.u = self.model.u0.copy()

    def set(self, name: str, value: float) -> str:
        """What was set, "parameter" or "input"; "" if `name` is not known. The bare name of a vector sets all entries."""
        for table in (self.parameters, self.inputs):
            found = places(table, name)
            if not found:
                continue
            if table is self.parameters:
                p = self.instance.parameters
                p[found] = value
                self.instance.set_parameters(p)
                return "parameter"
            self.u[found] = value
            self.instance.set_input(self.u)
            return "input"
        return ""


def places(table: Mapping[str, int], name: str) -> list[int]:
    """Places of `name` in a table of scalar names; the bare name of a vector has those of all its entries."""
    return [i for n, i in table.items() if n == name or n.partition("[")[0] == name]


def booking(model: Model) -> Booking:
    """Audit names of a model's ledger: members (or the model itself) and port pairs with their junctions."""
    d = model.declaration
    components = tuple(m or model.name for m in model.members)
    at = {end: name for name, ends in d.junctions for end in ends}
    pairs = []
    for p, _ in ordered_ports(d):
        short = p.name.removeprefix(p.owner + ".") if p.owner else p.name
        for j in range(p.n):
            index = None if p.size is None else j + 1
            pairs.append((p.owner or model.name, short, index, at.get(p.name)))
    return Booking(components, tuple(pairs))


class Monolithic:
    """One instance (Python or native) that is the whole system."""

    what, instead = "one composed model", ""

    def __init__(self, model: Model, instance: Any):
        self.model, self.instance = model, instance
        self.booking = booking(model)
        self._inputs = Inputs(instance, model)
        self._columns = Columns(model, instance.layout)
        self.names = self._columns.names
        #: makes rows within the steps, if asked for
        self.dense: Dense | None = None

    def settable(self) -> list[str]:
        return [*self._inputs.parameters, *self._inputs.inputs]

    def set_value(self, name: str, value: float) -> str:
        """Set a parameter or free input and say which it is; KeyError names close ones."""
        kind = self._inputs.set(name, value)
        if kind:
            return kind
        d = self.model.declaration
        if name in {n for v in (*d.states, *d.algebraics) for n in (v.name, *v.names())}:
            raise KeyError(f"{d.name}: '{name}' follows from the equations; set a parameter or a free input")
        raise KeyError(d.unknown_name(name))

    def read(self) -> Array:
        """Values of `names` now."""
        return self._columns.now(self.instance)

    def energies(self) -> Array:
        return self.instance.signal("H")

    def check_start(self) -> None:
        require_consistent(self.model, self.instance)

    def project_start(self, t0: float, kept: Sequence[str] = ()) -> Projection | None:
        """Move the state onto its hidden constraints, but not the states `kept`; None if it has none."""
        if not self.model.checks:
            return None
        from phfmu.discretise.start import project_start

        found = project_start(self.model, self.instance.x, p=self.instance.parameters, t=t0, keep=kept)
        self.instance.set_x(t0, found.x)
        self.instance.initialise()
        return found

    def advance(self, t0: float, h: float, n: int, first: int = 0) -> Steps:
        try:
            return self.taken(self.instance, t0, h, n, first)
        except StepFailure as failure:
            if len(failure.recorded.get("counts", ())):
                failure.recorded = {"steps": self._steps(failure.recorded)}
            raise

    def companion(self, scheme: Scheme) -> Any:
        """An instance of the same declaration and engine under another scheme."""
        return type(self.instance)(build_model(self.model.declaration, scheme))

    def taken(self, instance: Any, t0: float, h: float, n: int, first: int = 0) -> Steps:
        """n steps of the instance or of a companion."""
        wanted = ("signals", "energy", "stored", "dissipated", "supplied", "moved", "pairs", "counts")
        if instance.model.loses_energy:
            wanted += ("numerical",)
        if self.dense is None:
            return self._steps(instance.run(t0, h, n, record=wanted, first=first))
        before = np.concatenate(list(instance.signals().values()))
        r = instance.run(t0, h, n, record=(*wanted, "unknowns"), first=first)
        rows = self.dense.between(instance, before, r, t0, h, first)
        picked = self._columns.pick(rows.reshape(-1, rows.shape[-1])).reshape(*rows.shape[:2], -1)
        return replace(self._steps(r), between=picked)

    def _steps(self, r: dict[str, Array]) -> Steps:
        return Steps(
            self._columns.pick(r["signals"]), r["energy"], r["stored"], r["dissipated"], r["supplied"], r["pairs"],
            r["counts"][:, 0], r.get("numerical"), r["moved"],
        )  # fmt: skip


PROJECT = "let the run move the start onto it with --project (energy change booked)"


def require_consistent(model: Model, instance: Any, instead: str = PROJECT) -> None:
    """InconsistentState if a hidden constraint of the present state exceeds its tolerance; `instead` of better values."""
    from phfmu.declare.junction_words import junction_words
    from phfmu.discretise.model import CONSISTENCY

    if not model.checks:
        return
    values = instance.signal("observables")[-len(model.checks) :]
    bad = [
        f"{c.name}: {junction_words(model.declaration, c.name, v) or f'{c.level} residual {v:.6g}'} "
        f"(tolerance {CONSISTENCY * s:.3g})"
        for c, v, s in zip(model.checks, values, model.check_scale, strict=True)
        if not abs(v) <= CONSISTENCY * s
    ]
    if bad:
        raise InconsistentState(
            f"{model.name}: inconsistent start: {'; '.join(bad)}. A start off the constraints would chatter for ever; "
            f"change the start values so that the constraint holds (position, velocity or sum of currents), or {instead}"
        )
