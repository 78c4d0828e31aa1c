"""One FMU as the whole system of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.rest_changes import RestChange
from phfmu.fmu.importer.reader import FMUInstance
from phfmu.interrupt import Interrupted
from phfmu.network.members.fmu_member import FMUMember
from phfmu.outcome.status import EndRequested, StepFailure
from phfmu.outcome.steps import Steps
from phfmu.signals import SignalKind
from phfmu.words import meant

Array = NDArray[np.float64]


class FMUStepper:
    """One FMU as the whole system of a run."""

    what, instead = "an FMU, whose method is compiled in", "run the declaration with --engine native or python"
    CARRIED = ("member", "booking", "_u")

    def __init__(self, unit: FMUInstance):
        self.member = FMUMember(unit.name, unit)
        self.unit = unit
        self.names = self.member.names
        self.booking = self.member.booking
        self._u = unit.start_inputs()

    @property
    def units(self) -> dict[str, str]:
        return self.member.units

    @property
    def kinds(self) -> Mapping[str, SignalKind]:
        return self.member.kinds

    @property
    def labels(self) -> Mapping[str, str]:
        return self.member.labels

    def inputs(self) -> dict[str, float]:
        """Inputs of ports and others, as they are now."""
        given = self._u / self.member.input_sign
        return dict(zip(self.member.input_names, given.tolist(), strict=True)) | self.member.signals()

    @property
    def unwritten(self) -> list[str]:
        """Name of the unit with the reason, if its state cannot be written to a file."""
        return [self.member.unwritten] if self.member.unwritten else []

    @property
    def lands(self) -> bool:
        """A unit ends no step on a zero of a guard: it handles events inside its steps."""
        return False

    def notes(self) -> list[str]:
        """No lines about the run: a unit has none."""
        return []

    def hashed(self) -> dict[str, dict[str, float]]:
        """Its states and its time, by their names."""
        return {self.member.name: self.member.hashed()}

    @property
    def junctions(self) -> Array:
        """No junction unknowns: a unit tells none."""
        return np.zeros(0)

    @property
    def modes(self) -> tuple[int, ...]:
        """No modes: switches of a unit are its own."""
        return ()

    def settable(self) -> list[str]:
        return self.member.settable()

    def set_value(self, name: str, value: float) -> str:
        """Set an input or tunable parameter and say which; KeyError names close ones, ValueError refuses fixed parameters."""
        found = self.member.input_places(name)
        if not found:
            if kind := self.member.set_parameter(name, value):
                self.booking = self.member.booking
                return kind
            raise KeyError(f"{self.unit.name} has no input '{name}'; {meant(name, self.settable())}")
        self._u[found] = value * self.member.input_sign[found]
        self.unit.set_input(self._u)
        return "input"

    def read(self) -> Array:
        return self.member.read()

    def energies(self) -> Array:
        return self.unit.energies()

    def rest_changes(self) -> dict[str, list[RestChange]]:
        return {"": self.member.rest_changes()}

    def check_changed(self) -> None:
        self.check_start()

    def check_start(self) -> None:
        self.member.check_start()

    def project_start(self, t0: float, kept: Sequence[str] = ()) -> None:
        """The state of a unit is its own; ValueError tells how to start."""
        raise ValueError(
            f"{self.unit.name}: a start inside an FMU cannot be projected at t = {t0:g} s; set start values"
        )

    def prepare(self, t0: float, h: float) -> None:
        """A unit has its values from its own start."""

    def advance(self, t0: float, h: float, n: int, first: int = 0) -> Steps:
        rows: list[dict[str, Any]] = []
        for k in range(n):
            try:
                self.member.do_step(t0 + (first + k) * h, h)
                rows.append(self._row())
                if self.unit.steps.ended:
                    raise EndRequested(self.unit.name, self.unit.time, 0.0, self.unit.time)
            except (StepFailure, Interrupted) as failure:
                failure.recorded = {"steps": Steps.stacked(rows)} if rows else {}
                if isinstance(failure, EndRequested) and failure.reached > failure.time:
                    failure.last = Steps.stacked([self._row()])
                raise
        return Steps.stacked(rows)

    def _row(self) -> dict[str, Any]:
        """The record of the last step: the fields of `Steps`."""
        known = {"signals": self.read(), "H": self.energies(), "events": self.member.happened()}
        return known | self.member.ledger()
