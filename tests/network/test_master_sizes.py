"""The compiled loop with many members: what it begins with."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

from phfmu import (
    Collocated,
    Coupled,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    PythonInstance,
    build_model,
    run,
)
from phfmu.components.mechanical.translational import mass, spring
from phfmu.network.couplings.compiled.master_pattern import MasterPattern, exchange_tables
from phfmu.network.couplings.newton import newton
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.studies.bench.apart import coupling as coupling_bench
from phfmu.studies.bench.apart import networks as apart_bench
from tests.network.both_loops import SAME, members
from tests.wide import wide


def ring(n: int) -> Network:
    """Masses with springs between them."""
    net = Network("ring")
    for i in range(n):
        net.add(f"m{i}", mass(1.0, q=0.1 * (i == 0)))
        net.add(f"s{i}", spring(100.0))
    for i in range(n):
        net.junction(f"j{i}", [f"m{i}.flange", f"s{i}.a", f"s{(i - 1) % n}.b"])
    return net


def pattern(net: Network, k: int) -> tuple[int, int, int]:
    """Unknowns, entries, room for factors."""
    joined = CoupledMembers(net, members(net, k, PythonInstance))
    found = exchange_tables(joined, newton(joined))
    made = MasterPattern(found)
    return found.size, len(made.rowind), made.capacity


@pytest.mark.parametrize("k", wide([1, 2], 2))
def test_the_interface_matrix_of_a_ring_is_sparse(k: int) -> None:
    """Twice the members, twice the entries."""
    (n, entries, _), (n2, entries2, room2) = pattern(ring(40), k), pattern(ring(80), k)
    assert n2 == 2 * n and entries2 == 2 * entries
    assert room2 < n2**2 / 4


@pytest.mark.slow
@pytest.mark.parametrize("make", [coupling_bench.ring, coupling_bench.star])
def test_what_a_run_begins_with_grows_with_the_members_only(make: Callable[[int], Network]) -> None:
    """Memory to join members, check their start and take the first steps: nothing is as large as unknowns squared."""
    peak = {}
    for n in (30, 30, 120):  # the first one loads what is needed
        stepper = apart_bench.coupled(make(n), 1)
        apart = stepper.joined  # pyright: ignore[reportAttributeAccessIssue]
        tracemalloc.start()
        try:
            again = Coupled(apart.network, apart.members)
            again.check_start()
            again.prepare(0.0, 0.01)
            again.advance(0.0, 0.01, 2)
            peak[n] = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        assert again.master.taken == 2
    assert peak[120] <= 5.0 * peak[30]


@pytest.mark.slow
def test_a_ring_of_many_members() -> None:
    """Energy stays, and the books close, with sparse factors (more than 64 unknowns)."""
    net = ring(40)
    stepper = Coupled(net, members(net, 2))
    model = build_model(net.compose(), Collocated(2))
    one = run(Monolithic(model, NativeInstance(model)), Options(stop=0.2, step=0.02))
    two = run(stepper, Options(stop=0.2, step=0.02))
    assert np.abs(two.column("m7.q") - one.column("m7.q")).max() <= SAME
    assert two.ledger.summary().closed
