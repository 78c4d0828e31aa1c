"""Violations of a ledger: their kind, where they are, and how they are told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from phfmu.audit.kinds import LedgerVerdict, Quality
from phfmu.audit.summing.sums import ratio


class ViolationKind(StrEnum):
    """Kinds of violations."""

    # of a component
    BALANCE = "balance"
    DISSIPATION = "dissipation"
    PORTS = "ports"
    GAP = "gap"
    CHANGE = "change"
    RUN = "run"
    DRIFT = "drift"
    # of a port
    EXCHANGED = "exchanged"
    # of a junction
    JUNCTION = "junction"
    PARTS = "parts"
    # of the network
    UNEXPLAINED = "unexplained"
    UNEXPLAINED_RUN = "unexplained run"
    # rows of a log that contradict each other
    FILE = "file"


#: kinds of violations of a component
COMPONENT = (
    ViolationKind.BALANCE,
    ViolationKind.DISSIPATION,
    ViolationKind.PORTS,
    ViolationKind.GAP,
    ViolationKind.CHANGE,
    ViolationKind.RUN,
    ViolationKind.DRIFT,
)
#: and of a junction
JUNCTION = (ViolationKind.JUNCTION, ViolationKind.PARTS)
#: and of the network
NETWORK = (ViolationKind.UNEXPLAINED, ViolationKind.UNEXPLAINED_RUN)

_TEXT = {
    ViolationKind.BALANCE: "{name}: step {step} at t = {t0:.9g} s misses {size:.3e} J",
    ViolationKind.DISSIPATION: "{name}: step {step} at t = {t0:.9g} s dissipates {size:.3e} J; "
    "a dissipation cannot be negative",
    ViolationKind.PORTS: "{name}: step {step} at t = {t0:.9g} s is booked as supplied with {size:.3e} J more than its ports say",
    ViolationKind.GAP: "{name}: H changed by {size:.3e} J between its steps, before step {step} at t = {t0:.9g} s; "
    "no event books it",
    ViolationKind.CHANGE: "{name}: step {step} at t = {t0:.9g} s changes H by {size:.3e} J more than it books as stored",
    ViolationKind.RUN: "{name}: the steps of the run miss {size:.3e} J together",
    ViolationKind.DRIFT: "{name}: H changed by {size:.3e} J more than the steps and events of the run book",
    ViolationKind.EXCHANGED: "{name}: step {step} at t = {t0:.9g} s passes {size:.3e} J more by the values that were exchanged "
    "than its member books",
    ViolationKind.PARTS: "{name}: step {step} at t = {t0:.9g} s: the parts of the junction's energy miss {size:.3e} J of it",
    ViolationKind.JUNCTION: "{name}: step {step} at t = {t0:.9g} s creates {size:.3e} J at the junction",
    ViolationKind.UNEXPLAINED: "{name}: step {step} at t = {t0:.9g} s leaves {size:.3e} J unexplained",
    ViolationKind.UNEXPLAINED_RUN: "{name}: the steps of the run leave {size:.3e} J unexplained",
    ViolationKind.FILE: "{note}",
}


@dataclass(frozen=True, slots=True)
class Violation:
    """Something of one kind that does not close at one place: its worst step, and how many steps do so.

    size and allowed [J].
    """

    kind: ViolationKind
    name: str
    step: int
    t0: float
    h: float
    size: float
    allowed: float
    steps: int = 1
    note: str = ""

    @property
    def ratio(self) -> float:
        """|size| / allowed; infinite where one of them is not a finite number."""
        return float(ratio(self.size, self.allowed))

    def __str__(self) -> str:
        if self.kind is ViolationKind.FILE:
            said = self.note
        else:
            said = _TEXT[self.kind].format(name=self.name, step=self.step, t0=self.t0, size=self.size)
            said += f"; allowed: {self.allowed:.1e} J"
        return said + (f" ({self.steps} steps)" if self.steps > 1 else "")


def word(
    violations: Sequence[Violation], kinds: Sequence[ViolationKind], name: str, quality: Quality = Quality.EXACT
) -> LedgerVerdict:
    """The verdict on one component, junction or network: closed, VIOLATED, or why it is not judged."""
    if any(v.name == name and v.kind in kinds for v in violations):
        return LedgerVerdict.VIOLATED
    return LedgerVerdict.CLOSED if quality is Quality.EXACT else LedgerVerdict(quality)
