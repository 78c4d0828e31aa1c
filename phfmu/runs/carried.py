"""State that a run carries from step to step: each class names its attributes in `CARRIED`; two functions take and give them.

What a class with `CARRIED` has under these names is gone into; of a class without it that has `get_state`, that is it; in a list
of such things each of them; an array keeps its place in memory, since others may share it; and everything else is kept as it
is, so it must be plain data.
"""

from __future__ import annotations

from typing import Any

import numpy as np


def _carries(thing: Any) -> bool:
    return hasattr(type(thing), "CARRIED") or hasattr(thing, "get_state")


def carried(thing: Any) -> Any:
    """All that `thing` carries, as data that can be written to a file."""
    names = getattr(type(thing), "CARRIED", None)
    if names is not None:
        return {name: carried(getattr(thing, name)) for name in names}
    if _carries(thing):
        return thing.get_state()
    if isinstance(thing, list) and any(map(_carries, thing)):
        return [carried(one) for one in thing]
    return thing


def carry(thing: Any, found: Any) -> Any:
    """Let `thing` go on from the data of `carried`, possibly of another process, and return what stands in its place then."""
    if hasattr(type(thing), "CARRIED"):
        for name, value in found.items():
            old = getattr(thing, name)
            new = carry(old, value)
            if new is not old:
                setattr(thing, name, new)
    elif _carries(thing):
        thing.set_state(found)
    elif isinstance(thing, list) and any(map(_carries, thing)):
        for one, own in zip(thing, found, strict=True):
            carry(one, own)
    elif isinstance(thing, np.ndarray) and isinstance(found, np.ndarray) and thing.shape == found.shape:
        thing[...] = found
    else:
        return found
    return thing
