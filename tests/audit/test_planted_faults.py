"""Planted faults: the guilty member or connection is named first, and nobody is named without a fault."""

from __future__ import annotations

import numpy as np
import pytest

from phfmu.studies.blame.campaign import Exclusion, outcome
from phfmu.studies.blame.faults import FaultKind, FaultPlace
from phfmu.studies.blame.networks import COUPLINGS, KINDS, draw
from phfmu.studies.blame.report import CampaignResult, measure, misses, page, summary, table


@pytest.mark.slow
def test_small_networks(compiler: None) -> None:
    """Twelve faults in networks of two or three members."""
    found = measure(3, 12, most=3)
    assert len(found.outcomes) == 12 and all(o.hit for o in found.outcomes), misses(found)
    assert not any(o.control or o.innocent for o in found.outcomes)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_the_campaign(compiler: None, seed: int) -> None:
    """Of 200 faults 95 % are named first; an innocent one is in at most 1 % of the runs."""
    found = measure(seed)
    assert len(found.outcomes) == 200, summary(found)
    assert sum(o.hit for o in found.outcomes) >= 190, misses(found)
    assert sum(o.innocent for o in found.outcomes) <= 2 and sum(bool(o.control) for o in found.outcomes) <= 2


def test_networks_are_drawn_as_asked() -> None:
    """Trees: a junction for each store, whose ends are one less than the members and junctions together."""
    for i in range(40):
        rng = np.random.default_rng(i)
        n, kind = int(rng.integers(2, 9)), [*KINDS][i % len(KINDS)]
        drawn = draw(rng, n, kind, COUPLINGS[i % len(COUPLINGS)])
        net = drawn.network
        assert len(net.members) == n and drawn.booked <= set(net.members)
        assert not drawn.driven or drawn.driven in drawn.booked
        assert sum(len(j.ends) for j in net.junctions) == n + len(net.junctions) - 1
    again = draw(np.random.default_rng(5), 6, "mixed", "newton"), draw(np.random.default_rng(5), 6, "mixed", "newton")
    assert [*again[0].network.members] == [*again[1].network.members] and again[0].booked == again[1].booked


@pytest.mark.slow
def test_a_gain_of_a_store_without_books_is_left_out(compiler: None) -> None:
    """It is a store of another size: passive, whatever the gain."""
    for attempt in range(200):
        found = outcome(11, 0, attempt, most=2)
        if found.where is FaultPlace.UNBOOKED and found.guilty[0] in "mCJ":
            break
    assert found.fault.kind is FaultKind.GAIN and found.left_out == Exclusion.PASSIVE


def test_the_page_tells_what_was_left_out() -> None:
    found = CampaignResult(3)
    found.left_out[FaultKind.GAIN, Exclusion.PASSIVE] = 4
    assert "| gain | 0 | 0 | 0 | 0 | 0 | 0 | 4 | 0 | 0 |" in table(found)
    assert summary(found) in page([found]) and "4 draws left out" in summary(found)
