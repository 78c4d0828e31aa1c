"""Python's collector of cycles rests while many objects are made that all stay.

It visits every object there is again whenever their number has grown by a quarter, to find none that is free.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def resting() -> Iterator[None]:
    """Without the collector within; as it was after it, also after an error."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()
