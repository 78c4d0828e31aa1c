"""Runs of scenes, composed or coupled, and what is read off them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pages import Array, PageBlock, table

from phfmu import Collocated, Coupled, EngineMember, Monolithic, NativeInstance, Options, Scene, build_model, run
from phfmu.network.couplings.coupling_table import COUPLINGS
from phfmu.runs.result import Result


def couplings() -> PageBlock:
    """Couplings by the names that users know: order, what members need, what it is."""
    rows = [[f"`{r.name}`", r.about, r.order, r.needs] for r in COUPLINGS.values()]
    return table(["coupling", "what", "order", "needs"], rows)


def monolithic(scene: Scene, h: float, stop: float, k: int, impulses: bool = True) -> Result:
    """The composed scene, k Gauss nodes."""
    model = build_model(scene.declaration(), Collocated(k, impulses=impulses))
    return run(Monolithic(model, NativeInstance(model)), Options(stop=stop, step=h, events=scene.events))


def newton(scene: Scene, h: float, stop: float, k: int) -> Result:
    """Members stepped apart."""
    members = []
    for name, declaration in scene.system.members.items():  # type: ignore[union-attr]
        model = build_model(replace(declaration, name=name), Collocated(k))
        members.append(EngineMember(name, model, NativeInstance(model)))
    return run(Coupled(scene.system, members), Options(stop=stop, step=h, events=scene.events))  # type: ignore[arg-type]


def at(result: Result, times: Array, name: str) -> Array:
    """A signal at given times of the grid."""
    rows = [int(np.argmin(np.abs(result.time - t))) for t in times]
    assert np.allclose(result.time[rows], times, rtol=0, atol=1e-12)
    return result.column(name)[rows]


def worst(result: Result) -> float:
    """Largest step residual of a component relative to the energy in play."""
    return max(c.worst_relative for c in result.ledger.summary().components)


def kirchhoff(result: Result) -> float:
    """Largest sum of joined currents at the end of a step."""
    return max(v for n, v in result.worst.items() if "bus" in n)
