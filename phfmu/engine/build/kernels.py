"""The kernels of a model as a set: equal ones once, in an order and with a token that come from their content alone.

However kernels are run, compiled or interpreted, a plan finds them by the same index, and a saved state of the one is one of the
other.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

from phfmu.engine.build.operations import Operations, operations
from phfmu.plan.plan import Kernel, Plan


@dataclass(frozen=True, eq=False)
class KernelOperations:
    """A kernel with the operations of its function and of its ledger."""

    kernel: Kernel
    function: Operations
    ledger: Operations | None

    @property
    def tables(self) -> dict[str, Operations]:
        """The tables of each function of the kernel in the runtime."""
        ledger = {} if self.ledger is None else {"ledger": self.ledger}
        return {"value": self.function.only(1), "full": self.function, **ledger}

    @cached_property
    def digest(self) -> bytes:
        ledger = b"" if self.ledger is None else self.ledger.digest
        return hashlib.sha256(self.function.digest + ledger).digest()


class Kernels:
    """`members`: one of each; `token`: of them all."""

    def __init__(self, kernels: Iterable[Kernel]) -> None:
        self._given = {id(k): k for k in kernels}  # keeps them, and with them what they are found by
        found = {key: _of(k) for key, k in self._given.items()}
        unique = {of.digest: of for of in found.values()}
        order = sorted(unique)
        self.members = tuple(unique[digest] for digest in order)
        self.token = int.from_bytes(hashlib.sha256(b"".join(order)).digest()[:8], "little")
        self._places = {key: order.index(of.digest) for key, of in found.items()}

    @property
    def size(self) -> int:
        """Operations in all of them."""
        return sum(len(m.function.code) for m in self.members)

    @property
    def unknown(self) -> list[str]:
        """Names of operations that are not interpreted."""
        tables = (t for m in self.members for t in (m.function, m.ledger) if t is not None)
        return sorted({name for t in tables for name in t.unknown()})

    def work(self, plan: Plan) -> int:
        """Operations of an evaluation of a plan whose kernels these are."""
        return sum(g.n * len(self.members[self.index(g.kernel)].function.code) for g in plan.groups)

    def index(self, kernel: Kernel) -> int:
        """Place of one of the kernels this was made of."""
        if id(kernel) not in self._places:
            raise KeyError(f"kernel {kernel.name} is not among these")
        return self._places[id(kernel)]


def _of(kernel: Kernel) -> KernelOperations:
    function = operations(kernel.function)
    given = [*function.arguments, *function.results]
    expected = [kernel.nx, kernel.ny, kernel.np, kernel.no, kernel.nj]
    if given != expected:
        raise ValueError(f"kernel {kernel.name}: (nx, ny, np, no, nj) = {expected}, its function has {given}")
    ledger = None if kernel.ledger is None else operations(kernel.ledger)
    told = ("stored", "lost", "numerical") if kernel.loses_energy else ("stored", "lost")
    if ledger is not None and ledger.results != (1,) * len(told):
        raise ValueError(f"kernel {kernel.name}: {', '.join(told)} are one dense value each, not {[*ledger.results]}")
    return KernelOperations(kernel, function, ledger)
