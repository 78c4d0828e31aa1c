"""Places of the values of a design: parameters, states and free inputs of one composed model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from phfmu.discretise.model import Model
from phfmu.network.members.inputs import places
from phfmu.network.scene import Event

#: kinds of places, in the order of runtime/runs.c
PARAMETER, STATE, INPUT = range(3)


@dataclass(frozen=True)
class RunPlace:
    """The place of a value that runs set: entry `index` of the parameters, states or inputs."""

    kind: int
    index: int


class Places:
    """Places of the values that runs may set, by name."""

    def __init__(self, model: Model):
        d = self._declaration = model.declaration
        names = (
            [n for v in d.parameters for n in v.names()],
            [n for v in d.states for n in v.names()],
            [n for p in d.ports if p.external for n in p.input_names()],
        )
        self._tables = [{n: i for i, n in enumerate(kind)} for kind in names]

    def of(self, name: str, kinds: Sequence[int] = (PARAMETER, STATE, INPUT)) -> list[RunPlace]:
        """Entries that a name means, those of all entries for the bare name of a vector; KeyError names close ones."""
        for kind in kinds:
            found = places(self._tables[kind], name)
            if found:
                return [RunPlace(kind, i) for i in found]
        raise KeyError(self._declaration.unknown_name(name))

    def require_free(self, names: Sequence[str], events: Sequence[Event], t0: float) -> None:
        """Raise ValueError if an event at the start sets a value that varies."""
        varied = {p: name for name in names for p in self.of(name)}
        for e in (e for e in events if e.t <= t0):
            for p in self.of(e.name, (PARAMETER, INPUT)):
                if p in varied:
                    raise ValueError(
                        f"'{varied[p]}' varies, but the scene sets {e.name} = {e.value:g} at its start; vary another name"
                    )
