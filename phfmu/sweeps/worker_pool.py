"""Pools of workers that take blocks of runs: threads of this process, or the workers of a Dask cluster."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import local
from typing import Any, Protocol

from numpy.typing import NDArray

from phfmu import __version__
from phfmu.sweeps.outcome import RunOutcomes

#: hands over runs (n x names) of which the first has this number
Submit = Callable[[NDArray[Any], int], "Future[RunOutcomes]"]

#: seconds after which a scheduler that does not answer is given up
PATIENCE = 10.0


class Runs(Protocol):
    """A runner, which takes one run after the other."""

    def take(self, rows: NDArray[Any], first: int = 0) -> RunOutcomes: ...
    def stop(self) -> None: ...


class WorkerPool(Protocol):
    """Workers that take blocks of runs, `size` of them at a time."""

    @property
    def size(self) -> int: ...
    def at_work(self, blocks: int) -> Any:
        """Return a context manager whose value submits one of so many blocks; no block is begun after its end."""
        ...


class Threads:
    """Threads of this process, each with the runner that `make` gives it; the first one is made here, which compiles.

    The main thread takes none, so that it hears of signals; when it leaves, runs under way end with their present step.
    """

    def __init__(self, make: Callable[[], Runs], jobs: int):
        self._make, self.size = make, jobs

    @contextmanager
    def at_work(self, blocks: int) -> Iterator[Submit]:
        own, made, first = local(), list[Runs](), [self._make()]

        def begin() -> None:
            own.runs = first.pop() if first else self._make()
            made.append(own.runs)

        pool = ThreadPoolExecutor(min(self.size, blocks), initializer=begin)
        try:
            yield lambda rows, number: pool.submit(lambda: own.runs.take(rows, number))
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for runs in made:
                runs.stop()
            pool.shutdown(wait=True)


@dataclass(frozen=True)
class Scheduler:
    """The address of a Dask cluster (tcp://host:port), or the file that it wrote."""

    address: str = ""
    file: str = ""


class Cluster:
    """Workers of a Dask cluster; each of their threads has a runner of its own, which `make` gives when it is called there."""

    def __init__(self, client: Any, make: Callable[[], Runs]):
        from cloudpickle import dumps  # pyright: ignore[reportMissingImports]

        self._client, self._recipe = client, dumps(make)
        self.size = sum(client.nthreads().values())

    @contextmanager
    def at_work(self, blocks: int) -> Iterator[Submit]:
        del blocks
        pool = self._client.get_executor(pure=False, retries=0)
        try:
            yield lambda rows, number: pool.submit(take, self._recipe, rows, number)
        finally:
            pool.shutdown(wait=False)  # what is not done is cancelled


@contextmanager
def cluster(make: Callable[[], Runs], scheduler: Scheduler) -> Iterator[Cluster]:
    """Yield the pool of a cluster, connected until the end.

    Raises ValueError or OSError if there is no scheduler, no worker, or another version of phfmu.
    """
    try:
        from distributed import Client  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ValueError("a scheduler needs Dask: pip install 'phfmu[dask]'") from None
    where = scheduler.address or scheduler.file
    if scheduler.file and not Path(scheduler.file).is_file():
        raise FileNotFoundError(f"{where}: no such file; dask scheduler --scheduler-file {where} writes it")
    try:
        named = {"scheduler_file": scheduler.file} if scheduler.file else {"address": scheduler.address}
        client: Any = Client(**named, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise OSError(f"no Dask scheduler at {where} ({error}); start one with: dask scheduler") from None
    try:
        _require_workers(client, where)
        yield Cluster(client, make)
    finally:
        client.close()


def _require_workers(client: Any, where: str) -> None:
    """Raise ValueError if there are no workers, or some with another version of phfmu than here."""
    found: dict[str, Any] = client.run(_version, on_error="return")
    if not found:
        raise ValueError(f"the scheduler at {where} has no workers; start some with: dask worker {where}")
    for worker, version in found.items():
        if version != __version__:
            told = f"phfmu {version}" if isinstance(version, str) else f"no phfmu ({version})"
            raise ValueError(f"the worker {worker} has {told}, here it is {__version__}; install the same there")


def _version() -> str:
    import phfmu

    return phfmu.__version__


_own = local()


def take(recipe: bytes, rows: NDArray[Any], first: int) -> RunOutcomes:
    """Take runs on a worker, by a runner that is kept in its thread."""
    if getattr(_own, "recipe", None) != recipe:
        _own.runs, _own.recipe = pickle.loads(recipe)(), recipe
    return _own.runs.take(rows, first)
