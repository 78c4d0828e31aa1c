"""Balance of the links of a diagram of flows."""

from __future__ import annotations

import math
from collections.abc import Sequence

from phfmu.report.page.flows import Link, Node


def imbalance(found: Sequence[Link], node: Node) -> float:
    """Energy that a node takes less what it gives [J]."""
    return math.fsum(
        link.energy * ((link.target == node) - (link.source == node))
        for link in found
        if node in (link.source, link.target)
    )
