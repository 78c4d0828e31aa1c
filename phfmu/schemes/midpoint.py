"""The midpoint rule MP, the baseline without energy exactness: gradients at the midpoint, whatever H is.

E11 (x' - x) = h [(J - R) grad H((x + x')/2) + B u]_1,   0 = [..]_2
"""

from __future__ import annotations

from dataclasses import dataclass, field

from phfmu.schemes.collocated import Collocated


@dataclass(frozen=True)
class Midpoint(Collocated):
    """Collocation with one node and the gradient there; the residual of the balance is the error of that gradient."""

    k: int = field(default=1, init=False, repr=False)
    gradient: str = field(default="nodal", init=False, repr=False)
    name: str = "midpoint"
    impulses: bool = field(default=True, init=False, repr=False)
    node_values = False
