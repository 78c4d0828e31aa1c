"""Tables of docs/results/steps.md: a fault with and without restart steps, errors against tolerances, values within steps."""

from __future__ import annotations

from typing import Any

import numpy as np
from pages import PageBlock, table

from phfmu import Collocated, Monolithic, NativeInstance, Options, build_model, default_scheme, run
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.scenes.electrical.smib import smib
from phfmu.components.scenes.electrical.two_machine import two_machine
from phfmu.schemes.scheme import Scheme


def stepper(declaration: Any, scheme: Scheme) -> Monolithic:
    model = build_model(declaration, scheme)
    return Monolithic(model, NativeInstance(model))


def restart() -> PageBlock:
    """Voltage of phase b at the load of two_machine in V, at the fault and after the next steps of 100 us; lost energy."""
    scene, rows = two_machine(), []
    cases = {"order 2": (1, {}), "order 4": (2, {}), "order 2, one restart step": (1, {"restart": 1}),
             "order 2, two restart steps": (1, {"restart": 2}), "order 4, rtol 1e-8": (2, {"rtol": 1e-8})}  # fmt: skip
    for label, (k, options) in cases.items():
        s = stepper(scene.declaration(), Collocated(k))
        r = run(s, Options(stop=0.1005, step=1e-4, events=scene.events, landing=1e-4, **options))
        v = np.interp(0.1 + 1e-4 * np.arange(6), r.time, r.column("load.v[2]"))
        network = r.ledger.summary().network
        lost = 0.0 if network is None else network.numerical or 0.0
        rows.append([label, *(f"{value:.0f}" for value in v), f"{lost:.3g}"])
    return table(["steps", "at the fault", "1", "2", "3", "4", "5", "lost in J"], rows)


def tolerance() -> PageBlock:
    """Largest error of a state at the end, relative to 1 + its size, divided by rtol; in brackets the steps."""
    tolerances, rows = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8), []
    scene = smib()
    models = {
        "four_particle, 1 s": (four_particle(), 1.0, (), (2, 6), "two-level"),
        "smib, 0.1 s": (scene.declaration(), 0.1, scene.events, (4, 6), "collocated"),
    }
    for label, (declaration, stop, events, orders, name) in models.items():
        s = stepper(declaration, default_scheme(declaration, 6))
        run(s, Options(stop=stop, step=2.5e-4, events=events))
        exact = s.instance.x
        for order in orders:
            s, cells = stepper(declaration, default_scheme(declaration, order)), []
            for rtol in tolerances[: 3 if order == 2 else 5]:
                s.instance.reset()
                r = run(s, Options(stop=stop, step=1e-4, events=events, rtol=rtol))
                error = np.max(np.abs(s.instance.x - exact) / (1 + np.abs(exact)))
                cells.append(f"{error / rtol:.2g} ({r.steps})")
            rows.append([label, f"{name} {order}", *cells, *[""] * (len(tolerances) - len(cells))])
    return table(["model", "scheme", *(f"{t:g}" for t in tolerances)], rows)


def between() -> PageBlock:
    """Largest g, Dg v and distance of H from a straight line within the steps of four_particle, 1 s."""
    rows = []
    for order in (2, 6):
        for h in (0.02, 0.01):
            r = run(
                stepper(four_particle(), default_scheme(four_particle(), order)), Options(stop=1.0, step=h, dense=4)
            )
            assert r.interpolated is not None
            inside = r.interpolated
            g, w = (max(float(np.abs(r.column(n)[inside]).max()) for n in r.names if n.startswith(f"constraint.{level}"))
                    for level in ("position", "velocity"))  # fmt: skip
            stored = r.column("energy.stored")
            line = np.interp(r.time, r.time[~inside], stored[~inside])
            rows.append([f"{order}", f"{h:g}", f"{g:.1e}", f"{w:.1e}", f"{np.abs(stored - line).max():.1e}"])
    return table(["order", "h in s", "g in m2", "Dg v in m2/s", "H in J"], rows)
