"""Hashes of where a run is, each so many steps: one of each member, of the unknowns between them, and of pending events.

That of a member is of its states and its time, by their names, so that it is the same whichever engine or unit steps it; a unit
of another tool is hashed by all that it tells.  They stand in the audit, at the step whose end they are of.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from hashlib import blake2b
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from phfmu.audit.events import StateRow

if TYPE_CHECKING:
    from phfmu.network.couplings.stepper import Stepper
    from phfmu.runs.book import Book
    from phfmu.runs.march.march import BlockSize
    from phfmu.runs.options import Options

#: bytes of a hash: two states of one run are told apart but for 1 in 2^64
BYTES = 8
#: subjects of hashes beside members
UNKNOWNS, PENDING = "junction unknowns", "pending events"


def hashed(data: Iterable[bytes]) -> str:
    """The hash of pieces of data, in hexadecimal digits."""
    found = blake2b(digest_size=BYTES)
    for piece in data:
        found.update(piece)
    return found.hexdigest()


def hash_of_state(values: Mapping[str, float]) -> str:
    """The hash of the bits of values by name, in whatever order they are given."""
    return hashed(name.encode() + b"\0" + struct.pack("<d", values[name]) for name in sorted(values))


class March(Protocol):
    """The way from event to event, whose blocks end where hashes are due."""

    pace: BlockSize


class StateHashes:
    """Writes the hashes of a stepper that a march drives, each `options.hash_states` steps, to the sink of the audit."""

    def __init__(self, stepper: Stepper, book: Book, march: March, options: Options):
        self._stepper, self._book, self._sink = stepper, book, options.sink
        events = sorted(options.events, key=lambda e: e.t)
        self._times, self._values = np.array([e.t for e in events]), np.array([e.value for e in events])
        self._names = [e.name.encode() + b"\0" for e in events]
        march.pace.each(options.hash_states, self.write)

    def write(self) -> None:
        """The hashes at the end of the last step."""
        stepper, (t, h) = self._stepper, self._book.last
        subjects: dict[str, Any] = {name: hash_of_state(values) for name, values in stepper.hashed().items()}
        rows = [StateRow(self._book.steps - 1, t, h, name, None, found) for name, found in subjects.items()]
        others = {UNKNOWNS: [stepper.junctions.tobytes()], PENDING: self._pending(t + h)}
        rows += [
            StateRow(self._book.steps - 1, t, h, None, name, hashed(data)) for name, data in others.items() if any(data)
        ]
        self._sink.write_states(rows)

    def _pending(self, t: float) -> list[bytes]:
        """The modes that switches are in, and events that are to come after the time t."""
        first = int(np.searchsorted(self._times, t, side="right"))
        ahead = [self._times[first:].tobytes(), self._values[first:].tobytes(), *self._names[first:]]
        return [bytes(self._stepper.modes), *ahead]
