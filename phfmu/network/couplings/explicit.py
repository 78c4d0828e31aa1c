"""Explicit couplings: every member takes a step once, under inputs that the others' outputs give before it.

Before a group of members steps, the junction unknowns are those of the present states (`instant.py`): of members that have not
stepped yet at t, of the others at t + h.  They are held.  Outputs are those of an instant, not means of a step: lagged by one
step, means lose their conjugacy and the coupling is less stable.  What the junctions take, sum h U^T Y, is booked by the members.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from phfmu.network.couplings.coupling import Solution, Step
from phfmu.network.interface.instant import Instant
from phfmu.network.interface.joined import Joined

ORDER = 1


def stepped(joined: Joined, instant: Instant, last: Solution, step: Step, groups: Iterable[Sequence[int]]) -> Solution:
    """One step, group by group (places among the members); at its end each has the inputs that it took."""
    joined.follow(step.t, step.h)
    xi, used, U = last.xi, last.xi.copy(), joined.free.copy()
    for group in groups:
        xi = instant.solve(joined, xi, step.t)
        inputs = joined.inputs(xi)
        for i in group:
            place = joined.places[i]
            U[place] = inputs[place]
            fed, _ = joined.reach(i)
            used[fed] = xi[fed]
            joined.members[i].do_step(step.t, step.h)
    for m, place in zip(joined.members, joined.places, strict=True):
        m.set_input(U[place])
    return Solution(used, np.concatenate([m.output() for m in joined.members]))
