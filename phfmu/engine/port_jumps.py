"""Jumps of a model together with impulses at its ports, the part of one member in a jump that several share.

    x+ = x- + L [m, s, r],   c = L^T grad H,   S = L^T H'' L

m: impulses of its jumps, s: at its ports that take pairs (c is their output), r: of its own constraints.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.entries.alike import first_alike
from phfmu.declare.phdae import PHDAE
from phfmu.engine.impulses import port_kernels
from phfmu.events.impulse import ImpulseColumns
from phfmu.events.jump_columns import jump_columns
from phfmu.terms.canonical import components
from phfmu.terms.extraction.extract import extract
from phfmu.terms.port_impulses import Impulse, masses

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class JumpKernel:
    """Columns of the n jumps of a model, then of its ports with impulses, then of its constraints that meet them.

    inputs:  places of the ports' columns among the external inputs;  moved: states;  components: those with energy in play
    couples: jump -> places in `inputs` that S couples it with, through constraints too
    function: (x, p) -> c (components x N), L (moved x N), S (N x N), e (n)
    """

    inputs: tuple[int, ...]
    moved: tuple[int, ...]
    components: tuple[int, ...]
    couples: tuple[frozenset[int], ...]
    function: ca.Function

    def columns(self, x: Array, p: Array) -> ImpulseColumns:
        """The columns at the states x with the parameters p."""
        c, L, S, e = (np.array(v) for v in self.function(x, p))
        return ImpulseColumns(L, c, S, e.ravel())


def jump_kernel(model: PHDAE) -> JumpKernel | None:
    """The kernel, one for all models that are alike; None if nothing of them jumps.  DeclarationError as of `jump_columns`."""
    return _jump_kernel(first_alike(model))


@lru_cache(maxsize=64)
def _jump_kernel(model: PHDAE) -> JumpKernel | None:
    terms, forms = extract(model), port_kernels(model).forms
    odd = {j for p in forms.ports if p.kind is not Impulse.PAIR for j in p.inputs}
    names = [name for port in model.ports if port.external for name in port.input_names()]
    inputs, columns, mass = list[int](), list[tuple[str, ca.SX]](), masses(terms)
    for place, j in enumerate(forms.pairs):
        if j not in odd:
            column = ca.SX(terms.n1, 1)
            column[list(forms.states)] = forms.L[:, place]
            inputs.append(j)
            columns.append((names[j], ca.sparsify(column * mass)))
    found = jump_columns(terms, model.state_events, columns)
    if found is None:
        return None
    n = found.e.numel()
    x, p = ca.vertcat(ca.SX(0, 1), model.x), ca.vertcat(ca.SX(0, 1), *(v.sx for v in model.parameters))
    results = [ca.densify(ca.SX(v)) for v in (found.c, found.L, found.S, found.e)]
    function = ca.Function("jumps", [x, p], ca.cse(results), {"allow_free": False})
    return JumpKernel(
        tuple(inputs),
        tuple(found.moved),
        tuple(found.components),
        _coupled(ca.sparsify(found.S), n, len(inputs)),
        function,
    )


def _coupled(S: ca.SX, n: int, ports: int) -> tuple[frozenset[int], ...]:
    """The ports in the same block of S, for each of n jumps."""
    own = range(n, n + ports)
    of = {i: frozenset(j - n for j in part if j in own) for part in components(S) for i in part}
    return tuple(of.get(i, frozenset()) for i in range(n))
