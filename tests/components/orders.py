"""Observed orders."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from phfmu import Collocated, PythonInstance
from phfmu.discretise.model import build_model


def steps(model, k, h, n, inputs):
    """A Python instance after n steps with `inputs` at the k nodes, and the worst ledger gap of a step."""
    plan = build_model(model, Collocated(k))
    instance, worst = PythonInstance(plan), 0.0
    for i in range(n):
        instance.set_node_inputs(np.array([inputs(h * (i + c)) for c in plan.nodes]))
        instance.do_step(h * i, h)
        row = instance.ledger()
        gap = abs(float(np.sum(row["stored"] + row["dissipated"] - row["supplied"])))
        size = sum(float(np.sum(np.abs(row[r]))) for r in ("stored", "dissipated", "supplied", "pairs"))
        worst = max(worst, gap / (abs(float(np.sum(instance.signals()["H"]))) + size or 1.0))
    instance.set_node_inputs(np.array([inputs(h * n)] * k))
    return instance, worst


def orders(errors):
    return [float(np.log2(a / b)) for a, b in pairwise(errors)]
