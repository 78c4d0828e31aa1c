"""Rows of the audit beside those of steps: events, with their numbers, and hashes of states."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class EventRow:
    """Something outside the steps: input, parameter, state, reprojection, nonconverged, interrupted; energies in joule."""

    t: float
    kind: str
    component: str | None = None
    energy_jump: float | None = None
    message: str | None = None
    lost: float | None = None


@dataclass(frozen=True, slots=True)
class StateRow:
    """The hash of the state at the end of a step [t0, t0 + h] in s: of a component, or of another `part` of the run."""

    step: int
    t0: float
    h: float
    component: str | None
    part: str | None
    hash: str


class EventCount:
    """Counts events; one that changed several components is booked in as many rows, and counted once."""

    def __init__(self) -> None:
        self.kinds: dict[str, int] = {}
        self._last: tuple[float, str, str | None] | None = None
        self._changed: set[str | None] = set()

    def add(self, t: float, kind: str, component: str | None, message: str | None) -> None:
        """Take one row."""
        same = self._last == (t, kind, message) and None not in {component, *self._changed}
        if not same or component in self._changed:
            self.kinds[kind] = self.kinds.get(kind, 0) + 1
            self._last, self._changed = (t, kind, message), set()
        self._changed.add(component)
