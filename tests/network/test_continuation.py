"""Steps begin where the last five point: kinks and jumps of inputs cost no more trials than smooth ones, within one or two."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from phfmu import Collocated, Coupled, EngineMember, NativeInstance, build_model
from phfmu.components.scenes.electrical.smib import smib
from phfmu.network.couplings.newton import newton
from phfmu.network.members.interpolant import Interpolant

STEPS, EACH, TORQUE, KICK = 60, 6, 1.2e6, 3e6


def trials(k: int, h: float, kind: str) -> np.ndarray[Any, Any]:
    """Of each step; the torque of the shaft: smooth, bent every sixth step or every one, or jumping every sixth."""
    net: Any = smib().system
    name = "gen.shaft.torque"
    models = {n: build_model(d, Collocated(k)) for n, d in net.members.items()}
    own: list[Any] = [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()]
    coupled = Coupled(net, own, newton)
    coupled.check_start()
    coupled.prepare(0.0, h)
    found = []
    for first in range(0, STEPS, EACH):
        if kind == "jumps":
            coupled.set_value(name, TORQUE + KICK * (first // EACH % 2))
        elif kind != "smooth" and not first:
            rows: Any = np.arange(0, STEPS + 1, EACH if kind == "bends" else 1)
            values = TORQUE + KICK * (rows // rows[1] % 2)
            coupled.followed = Interpolant([name], rows * h, values[:, None].astype(float), "linear")
        found.append(np.array(coupled.advance(0.0, h, EACH, first).iterations))
    return np.concatenate(found)


@pytest.mark.slow
@pytest.mark.parametrize(("k", "h"), [(1, 1e-3), (2, 2e-3), (3, 2e-3)])
def test_kinks_cost_few_trials(k: int, h: float) -> None:
    smooth = trials(k, h, "smooth")
    for kind in ("bends", "bends in every step", "jumps"):
        found = trials(k, h, kind)
        assert found.mean() <= smooth.mean() + 0.5 and found.max() <= smooth.max() + 2, (kind, found)
