"""A million steps of the four particles without damping: energy, constraints, CPU time."""

from __future__ import annotations

import time

import numpy as np

from phfmu.components.mechanical.four_particle import four_particle
from phfmu.discretise.model import build_model, default_scheme
from phfmu.engine.native.native import NativeInstance


def main(steps: int = 1_000_000, h: float = 0.01) -> None:
    declaration = four_particle(eta0=0.0)
    for order in (2, 6):
        instance = NativeInstance(build_model(declaration, default_scheme(declaration, order)))
        start = instance.signal("H").sum()
        before = time.process_time()
        instance.run(0.0, h, steps)
        spent = time.process_time() - before
        energy = abs(instance.signal("H").sum() / start - 1)
        checks = np.abs(instance.signal("observables"))
        count = instance.counts
        print(
            f"k = {order // 2}: {spent:.2f} s, |dH|/H0 {energy:.1e}, |Dg v| {checks[:2].max():.1e}, |g| {checks[2:].max():.1e}, "
            f"{count['sweeps'] / count['steps']:.2f} sweeps a step, {count['iterations']} Newton iterations"
        )


if __name__ == "__main__":
    main()
