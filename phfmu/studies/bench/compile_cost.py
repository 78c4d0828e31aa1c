"""CPU time of the compiler for a model's library."""

from __future__ import annotations

import os
import resource
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def fresh_cache() -> Iterator[None]:
    """A cache of libraries of its own; the compiler keeps what it has built of its own run time."""
    from phfmu.engine.build.cache import cache_folder

    known, before = cache_folder(), os.environ.get("PHFMU_CACHE_DIR")
    with tempfile.TemporaryDirectory(prefix="phfmu-") as folder:
        if (known / "zig").is_dir():
            (Path(folder) / "zig").symlink_to(known / "zig")
        os.environ["PHFMU_CACHE_DIR"] = folder
        try:
            yield
        finally:
            os.environ.pop("PHFMU_CACHE_DIR")
            if before is not None:
                os.environ["PHFMU_CACHE_DIR"] = before


def compile_runtime() -> None:
    """Leave the objects of the runtime in the cache, as any model does."""
    from phfmu.engine.native.library import runtime

    runtime()


def compiler_seconds() -> float:
    """CPU time of finished child processes."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime
