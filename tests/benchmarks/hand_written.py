"""What the tables cost: the native engine beside a C program of the same method for the four particles alone."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np
from common import Run, medians, quartiles, rounds

from phfmu.components.mechanical.four_particle import four_particle
from phfmu.engine.build.compile import compile, host_flags
from phfmu.gradients.quadrature import nodes


def main(stop: float = 10.0) -> None:
    declaration, nd = four_particle(), nodes(3)
    built = compile({"hand_written.c": Path(__file__).parent / "hand_written.c"}, flags=host_flags())
    program = ctypes.CDLL(str(built.path)).hand_written
    program.restype = ctypes.c_double
    extended = np.vstack([nd.a, nd.b])
    multiplier = np.linalg.inv(np.block([[nd.a, -np.ones((3, 1))], [nd.b, np.zeros((1, 1))]]))
    known, wanted = np.append(0.0, nd.c - 1.0), np.append(nd.c, 1.0)
    ahead = np.array([[np.prod([(t - m) / (k - m) for m in known if m != k]) for k in known] for t in wanted])
    start = np.concatenate([declaration.states[0].start, declaration.states[1].start])

    for h in (0.0143, 0.01, 0.005):
        n, run = round(stop / h), Run(declaration, 6, h)
        state, sweeps = start.copy(), ctypes.c_longlong()
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (extended, multiplier, ahead, state)]

        def by_hand(h=h, n=n, pointers=pointers, state=state, sweeps=sweeps) -> float:
            state[:] = start
            return program(ctypes.c_double(h), n, *pointers, ctypes.byref(sweeps))

        worst = by_hand()
        run.job(stop)()
        apart = np.abs(run.instance.x - state).max()
        before = run.instance.counts["sweeps"]
        run.job(stop)()
        found = rounds({"hand": by_hand, "engine": run.job(stop)}, 50)
        us = {name: 1e6 * t / n for name, t in medians(found).items()}
        ratio = quartiles([spent["engine"] / spent["hand"] for spent in found])
        print(
            f"h {h:g}: by hand {us['hand']:.2f} us a step ({sweeps.value / n:.2f} sweeps, balance {worst:.0e} J), engine "
            f"{us['engine']:.2f} ({(run.instance.counts['sweeps'] - before) / n / 51:.2f}), {apart:.0e} apart after {stop:g} s, "
            f"ratio {ratio} (asked 2.2)"
        )


if __name__ == "__main__":
    main()
