"""State events of members, as the audit and the notes of a run tell them."""

from __future__ import annotations

from phfmu.discretise.model import Model
from phfmu.outcome.steps import EventRecord, StepEvent


class EventTexts:
    """State events of a model in words; `member`: whose names they are told under."""

    def __init__(self, model: Model, member: str = ""):
        assert model.events is not None
        self._names = model.events.names
        self._values = {e.guard.name: e for e in model.declaration.state_events}
        self._prefix = f"{member}." if member else ""

    def names(self, h: EventRecord) -> str:
        """Its guards and what switched, for a line about the run."""
        named = [self._names[i] + (" (comes to rest)" if i in h.rests else "") for i in h.events]
        return ", ".join(self._prefix + name for name in (*named, *h.switched))

    def message(self, h: EventRecord) -> str:
        """Its guards and what it sets, and what switched."""
        return "; ".join([*(self._said(i, i in h.rests) for i in h.events), *h.switched])

    def told(self, h: EventRecord) -> StepEvent:
        return StepEvent(h.t, h.energy, h.lost, self.names(h), self.message(h))

    def _said(self, i: int, rests: bool) -> str:
        name = self._names[i]
        event = self._values[name]
        values = {**event.sets, **(event.rest if rests else {})}
        return name + "".join(f", {n} = {v:.9g}" for n, v in values.items())
