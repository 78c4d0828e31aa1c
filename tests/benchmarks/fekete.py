"""Twenty charges on a sphere for a thousand seconds: CPU time beside the error against the published solution."""

from __future__ import annotations

import time
from statistics import median

import numpy as np

from phfmu.components.mechanical.fekete import fekete
from phfmu.discretise.model import build_model, default_scheme
from phfmu.engine.native.native import NativeInstance

#: positions of the first two charges at t = 1000 s: Mazzia, Magherini, Test Set for IVP Solvers (2008)
PUBLISHED = (-0.4070263380333202, 0.3463758772791802, 0.8451942450030429, 0.0775293475252155, -0.2628662719972299,
             0.9617122871829146)  # fmt: skip


def main(stop: float = 1000.0, rounds: int = 5) -> None:
    declaration = fekete()
    for order, h in ((2, 0.1), (6, 0.2), (6, 0.1), (6, 0.05)):
        model = build_model(declaration, default_scheme(declaration, order))
        spent, counts, x = [], {}, np.zeros(0)
        for _ in range(rounds):
            instance = NativeInstance(model)
            before = time.process_time()
            instance.run(0.0, h, round(stop / h))
            spent.append(time.process_time() - before)
            counts, x = instance.counts, instance.x
        print(
            f"order {order}, h = {h} s: {median(spent):.2f} s, error {np.abs(x[:6] - PUBLISHED).max():.1e} m, "
            f"{counts['sweeps'] / counts['steps']:.2f} sweeps a step, {counts['schur']} of {counts['steps']} steps without Newton"
        )


if __name__ == "__main__":
    main()
