"""Tables of docs/results/chain.md: orders on a damped chain and on a top with a singular mass matrix."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pages import PageBlock, independent, table

from phfmu import NativeInstance, TwoLevel, build_model
from phfmu.components.mechanical.chain import chain as chain_component
from phfmu.components.mechanical.heavy_top import heavy_top

SWING = {"n": 5, "damping": 0.3, "bending": 10.0, "speed": 2.0}


def chain() -> PageBlock:
    """Damped chain of five links, t = 0.4 s: errors and slopes of q, v, lambda_end, lambda (mean of the last step)."""
    solve = independent("chain_reference").chain
    q, v, lam = solve(0.4, **SWING)
    nodes, weights = np.polynomial.legendre.leggauss(5)
    rows, last = [], None
    for k, steps in ((1, (40, 80, 160, 320)), (3, (10, 20, 40))):
        for n in steps:
            h = 0.4 / n
            mean = sum(w / 2 * solve(0.4 - h * (1 - c) / 2, **SWING)[2]
                       for c, w in zip(nodes, weights, strict=True))  # fmt: skip
            instance = NativeInstance(build_model(chain_component(**SWING), TwoLevel(k)))
            r = instance.run(0.0, h, n, ("x", "a", "stored", "dissipated", "signals"))
            x = r["x"][-1]
            pairs = ((x[:15], q.ravel()), (x[15:], v.ravel()), (instance.signal("a_end"), lam), (r["a"][-1], mean))
            errors = [float(np.linalg.norm(a - b)) for a, b in pairs]
            checks = np.abs(r["signals"][:, instance.layout["observables"]])
            balance = np.max(np.abs(r["stored"] + r["dissipated"]))
            rows.append([2 * k, f"{h:g}", *_slopes(errors, last if n != steps[0] else None), f"{balance:.0e}",
                         f"{np.max(checks[:, 5:]):.0e}", f"{np.max(checks[:, :5]):.0e}"])  # fmt: skip
            last = errors
    return table(["order", "h / s", "q", "v", "lambda_end", "lambda", "balance / J", "g", "Dg v"], rows)


def top() -> PageBlock:
    """Heavy top in directors, singular M, t = 0.1 s: errors and slopes of q, v, and v of the director without mass."""
    q, v = independent("heavy_top_reference").heavy_top(0.1, precession=1.0)
    rows, last = [], None
    for k, steps in ((1, (50, 100, 200)), (3, (16, 32, 64))):
        for n in steps:
            instance = NativeInstance(build_model(heavy_top(precession=1.0), TwoLevel(k)))
            r = instance.run(0.0, 0.1 / n, n, ("x", "energy", "signals"))
            x = r["x"][-1]
            errors = [float(np.linalg.norm(x[s] - y)) for s, y in (
                (slice(0, 12), q), (slice(12, 21), v[:9]), (slice(21, 24), v[9:]))]  # fmt: skip
            checks = np.max(np.abs(r["signals"][:, instance.layout["observables"]]))
            drift = np.ptp(r["energy"]) / r["energy"][0, 0]
            rows.append([2 * k, f"{0.1 / n:.3g}", *_slopes(errors, last if n != steps[0] else None), f"{drift:.0e}",
                         f"{checks:.0e}"])  # fmt: skip
            last = errors
    return table(["order", "h / s", "q", "v", "v of d_3", "dH / H", "g and Dg v"], rows)


def _slopes(errors: Sequence[float], last: Sequence[float] | None) -> list[str]:
    if last is None:
        return [f"{e:.2e}" for e in errors]
    return [f"{e:.2e} ({np.log2(b / e):.2f})" for e, b in zip(errors, last, strict=True)]
