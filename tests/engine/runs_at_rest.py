"""Mechanisms in steps of an order, and how far a run is off."""

from __future__ import annotations

from typing import Any

import numpy as np

from phfmu import TwoLevel, build_model
from phfmu.discretise.model import Model


def model(declaration: Any, order: int) -> Model:
    return build_model(declaration, TwoLevel(order // 2))


def errors(instance: Any, h: float, steps: int, t: float = 0.0) -> tuple[float, float, float]:
    """Largest |g|, |Dg v| and change of H over a run; no step is halved."""
    before = instance.counts["substeps"]
    rows = instance.run(t, h, steps, ("signals", "energy"))
    checks = instance.model.checks
    values = np.abs(rows["signals"][:, instance.layout["observables"]][:, -len(checks) :])
    position = np.array([c.level == "position" for c in checks])
    assert instance.counts["substeps"] == before
    return values[:, position].max(), values[:, ~position].max(), np.ptp(rows["energy"])
