"""What a run carries from step to step: each class names its attributes in `CARRIED`; these two functions take and give them.

An attribute whose class has a `CARRIED` of its own is gone into, an instance is its saved state, an array keeps its place in
memory, since others may share it, and everything else is kept as it is, so it must be plain data.
"""

from __future__ import annotations

from typing import Any

import numpy as np


def carried(thing: Any) -> Any:
    """All that `thing` carries, as data that can be written to a file."""
    state = thing.get_state() if hasattr(thing, "get_state") else None
    names = getattr(type(thing), "CARRIED", None)
    if state is None and names is None:
        return thing
    return state, {name: carried(getattr(thing, name)) for name in names or ()}


def carry(thing: Any, found: Any) -> Any:
    """`thing` goes on from what `carried` gave, possibly in another process; what stands in its place then."""
    names = getattr(type(thing), "CARRIED", None)
    if not hasattr(thing, "get_state") and names is None:
        if isinstance(thing, np.ndarray) and isinstance(found, np.ndarray) and thing.shape == found.shape:
            thing[...] = found
            return thing
        return found
    state, values = found
    if state is not None:
        thing.set_state(state)
    for name, value in values.items():
        old = getattr(thing, name)
        new = carry(old, value)
        if new is not old:
            setattr(thing, name, new)
    return thing
