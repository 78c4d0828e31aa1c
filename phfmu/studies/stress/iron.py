"""Iron deep in saturation: energised transformers and ferroresonance, also against an integration by SciPy."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, hypot, pi, sqrt
from typing import Any

import numpy as np

from phfmu.studies.stress.case import StressCase, StressOutcome
from phfmu.studies.stress.drive import instance, record

#: peak of the source's voltage [V]
PEAK = 20e3 * sqrt(2.0 / 3.0)


def _declared(name: str, **arguments: Any) -> Any:
    from phfmu.components.library import build

    return build(name, **arguments).declaration()


def resonance(phase: float, least: float, most: float, h: float = 2e-5, order: int = 2) -> StressOutcome:
    """The voltage of the core over the last third of 0.3 s, as a part of the source's, between `least` and `most`."""
    d = _declared("ferroresonance", phase=phase)
    r = record(instance(d, order), h, round(0.3 / h))
    names = [n for v in d.states for n in v.names()]
    last = r.x[-round(0.1 / h) :, names.index("stray.charge")] / 0.1e-6
    found = float(np.abs(last).max()) / PEAK
    text = f"{found:.2f} times the voltage of the source; {r.iterations:.1f} iterations a step; balance {r.balance:.1e}"
    return StressOutcome(text, least < found < most and r.balance <= 1e-11)


def energised(residual: float, h: float = 1e-4) -> StressOutcome:
    """The largest magnetising current over 0.2 s, in parts of the rated peak."""
    d = _declared("inrush", residual=residual)
    r = record(instance(d), h, round(0.2 / h))
    names = [n for v in d.states for n in v.names()]
    flux = r.x[:, [j for j, n in enumerate(names) if n.startswith("unit.linkage")]]
    found = float(np.abs(flux).max()) / (400.0 * sqrt(2.0 / 3.0) / (100.0 * pi))
    text = f"flux of {found:.2f} times the rated peak; {r.iterations:.1f} iterations a step; balance {r.balance:.1e}"
    return StressOutcome(text, found > 1.5 and r.balance <= 1e-11)


def rates(phase: float) -> Callable[[float, np.ndarray], list[float]]:
    """The circuit in currents, voltages and a flux: (i of the source, v of the cable, i and v over the capacitor, v, flux)."""
    from phfmu.components.scenes.electrical.network_events import IRON

    V, S, w = 20e3 / sqrt(3.0), 1e6 / 3.0, 100.0 * pi
    Z = V**2 / 20e6
    R, L = Z / sqrt(5.0), 2.0 * Z / sqrt(5.0) / w
    f, i = np.array([(0.0, 0.0), *IRON.points]).T * [[PEAK / w], [sqrt(2.0) * S / V]]
    g, round_off = (np.diff(i) / np.diff(f)).tolist(), 0.3 * float(np.diff(f).min())
    bends = list(zip(np.diff(g).tolist(), f[1:-1].tolist(), strict=True))

    def slope(x: float) -> float:
        return (x + hypot(x, round_off)) / 2.0

    def at(t: float, y: np.ndarray) -> list[float]:
        i_s, v_a, i_c, v_c, v, flux = y.tolist()
        iron = g[0] * flux + sum(more * (slope(flux - k) - slope(-flux - k)) for more, k in bends)
        return [
            (PEAK * cos(w * t + phase) - R * i_s - v_a) / L,
            (i_s - i_c) / 0.2e-6,
            (v_a - v - v_c - 50.0 * i_c) / 0.2,
            i_c / 0.3e-6,
            (i_c - v / 400e3 - iron) / 0.1e-6,
            v - iron,
        ]

    return at


def peer(order: int, h: float, most: float, stop: float = 0.03) -> StressOutcome:
    """The flux at `stop` against DOP853 at 1e-11, as a part of its rated peak."""
    from scipy.integrate import solve_ivp

    d = _declared("ferroresonance")
    r = record(instance(d, order), h, round(stop / h))
    exact = solve_ivp(rates(-pi / 2.0), (0.0, stop), np.zeros(6), "DOP853", rtol=1e-11, atol=1e-9).y[-1, -1]
    names = [n for v in d.states for n in v.names()]
    error = abs(float(r.x[-1, names.index("iron.flux")]) - exact) * 100.0 * pi / PEAK
    text = f"error of the flux {error:.1e} of the rated peak; balance {r.balance:.1e}"
    return StressOutcome(text, error <= most and r.balance <= 1e-11)


CASES = (
    StressCase("ferroresonance", "switched at zero voltage", "above 1.8 times the source, balance <= 1e-11",
               lambda: resonance(-pi / 2.0, 1.8, 3.0)),
    StressCase("ferroresonance", "switched at the peak", "below the source, balance <= 1e-11", lambda: resonance(0.0, 0.5, 1.0)),
    StressCase("ferroresonance", "h = 1 ms, past all ringing", "finite, balance <= 1e-11",
               lambda: resonance(-pi / 2.0, 0.0, 100.0, h=1e-3)),
    StressCase("ferroresonance", "against DOP853, order 6", "error <= 1e-6", lambda: peer(6, 1e-5, 1e-6)),
    *(StressCase("inrush", f"residual flux of {x:g}", "flux above 1.5, balance <= 1e-11", lambda x=x: energised(x))
      for x in (0.0, 0.8)),
)  # fmt: skip
