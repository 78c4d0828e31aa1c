"""Straight chains of rigid links that hold each other by their tips: at the start the forces along them are free."""

import numpy as np
import pytest

from phfmu.studies.bench.apart.crews import chains
from phfmu.studies.bench.apart.networks import composed, instances, joined, planned


@pytest.mark.parametrize(("members", "links", "h"), [(2, 20, 1e-3), (2, 20, 1e-4), (4, 100, 1e-4)])
def test_straight_chains_start_at_every_step_size(members, links, h):
    """A straight chain gives way along itself in second order only: no step is so short that none is found."""
    network = chains(members, links)
    found = []
    for stepper in (joined(network, instances(planned(network, 1)), 1), composed(network, 1)):
        stepper.check_start()
        stepper.prepare(0.0, h)
        found.append(stepper.advance(0.0, h, 20, 0).signals[-1])
    assert np.abs(found[0] - found[1]).max() <= 1e-5
    assert np.abs(found[1]).max() > 1.0
