"""Three-phase capacitors between buses and from them to ground, as one part."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from phfmu import ELECTRICAL, PHDAE, Port, energy, parameter, state
from phfmu.components.electrical.phases import PHASES


def capacitor_network(
    C: Sequence[Sequence[float]], *, v: Sequence[Sequence[float]] = (), nominal: float = 1.0, rated: float = 1.0
) -> PHDAE:
    """Capacitors that join n buses: charge_k' = terminal_k.i,  v = S charge with S = C^-1 in each phase.

    `C` (n x n) [F] is the capacitance matrix, symmetric and positive definite: C_kk sums all capacitors at bus k, -C_kl is
    the one between k and l.  So capacitors in loops, as series capacitors between buses of lines with charging are, have
    charges that are independent, where parts of their own would have voltages that are not.

    H:  sum of the phases of charge^T S charge / 2;  J: 0;  R: 0
    states:      charge1 (3) .. [C], of all capacitors at bus 1 ..
    ports:       terminal1 ..: the current INTO the capacitors given, voltage out
    parameters:  S (n (n + 1)/2) [1/F]: the rows of the upper triangle of S
    `v` (n x 3): start voltages [V];  `nominal`: typical voltage [V];
    `rated`: typical current [A].  Raises ValueError for another matrix.
    """
    matrix = np.array(C, float)
    n = len(matrix)
    if matrix.shape != (n, n) or not np.allclose(matrix, matrix.T) or np.linalg.eigvalsh(matrix).min() <= 0:
        raise ValueError(
            f"capacitor_network: C = {matrix.tolist()} F must be symmetric and positive definite; at least one "
            "bus needs a capacitor to ground"
        )
    S = np.linalg.inv(matrix)
    upper = [(k, l) for k in range(n) for l in range(k, n)]
    inverse = parameter(
        "S", [S[at] for at in upper], len(upper), unit="1/F", description="inverse of the capacitance matrix"
    )
    begun = matrix @ (np.array(v, float) if len(v) else np.zeros((n, 3)))
    charges = tuple(
        state(f"charge{k + 1}", 3, unit="C", start=q.tolist(), nominal=matrix[k, k] * nominal,
              description=f"charge of the capacitors at bus {k + 1}", elements=PHASES)
        for k, q in enumerate(begun)
    )  # fmt: skip
    stored = sum(
        inverse[m] * charges[k][p] * charges[l][p] * (0.5 if k == l else 1.0)
        for m, (k, l) in enumerate(upper)
        for p in range(3)
    )
    return PHDAE(
        "capacitor_network",
        states=charges,
        parameters=(inverse,),
        energies=(energy(stored),),
        ports=tuple(
            Port(f"terminal{k + 1}", ELECTRICAL, "flow", {q: 1}, size=3, nominal=rated,
                 description=f"bus {k + 1}; current into the capacitors", elements=PHASES)
            for k, q in enumerate(charges)
        ),
        description=f"three-phase capacitors that join {n} buses",
    )  # fmt: skip
