"""The check of a scene: its declaration, its times and its events."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from difflib import get_close_matches

import numpy as np

from phfmu.checks.check import check
from phfmu.checks.run_values import check_values
from phfmu.declare.error import Problem
from phfmu.declare.phdae import PHDAE
from phfmu.network.network import Network
from phfmu.network.scene import Scene


def check_scene(scene: Scene, *, strict: bool = False) -> list[Problem]:
    """Problems of the declaration as `check` tells them, of stop and step, and of the events and what they set."""
    if scene.units and isinstance(scene.system, Network):
        return _check_apart(scene, scene.system, strict)
    declaration = scene.declaration()
    found = [*check(declaration, strict=strict), *_times(scene), *_events(scene, declaration)]
    if any(p.severity == "error" for p in found):
        return found
    return found + check_values(declaration, events=[e for e in scene.events if e.t < scene.stop])


def _check_apart(scene: Scene, network: Network, strict: bool) -> list[Problem]:
    """A network with units: its declared members one by one; what events may set of units, these tell when they run."""
    found = list(_times(scene))
    for name, declaration in network.declared.items():
        problems = [*check(declaration, strict=strict), *check_values(declaration)]
        found += [replace(p, entry=f"{name}: {p.entry}") for p in problems]
    return found


def _times(scene: Scene) -> Iterator[Problem]:
    for what in ("stop", "step"):
        value = getattr(scene, what)
        if not (np.isfinite(value) and value > 0):
            yield Problem("scene", f"scene '{scene.name}'", f"{what} = {value} s", "give a positive and finite time")


def _events(scene: Scene, declaration: PHDAE) -> Iterator[Problem]:
    """Names that can be set during a run, finite times and values."""
    variables = [(v.name, v.names()) for v in declaration.parameters]
    variables += [(p.input_names()[0].partition("[")[0], p.input_names()) for p in declaration.ports if p.external]
    known = {n for whole, names in variables for n in (whole, *names)}
    states = {n for v in (*declaration.states, *declaration.algebraics) for n in (v.name, *v.names())}
    for i, e in enumerate(scene.events):
        entry = f"event {i + 1}, {e.name} = {e.value:g} at t = {e.t:g} s"
        if not (np.isfinite(e.t) and np.isfinite(e.value)):
            yield Problem("event", entry, "time or value is not finite", "give finite numbers")
        if e.name in known:
            continue
        close = get_close_matches(e.name, sorted(known), 3)
        what = "is a state, which events do not set" if e.name in states else "is no parameter or free input"
        remedy = (
            f"did you mean {', '.join(close)}?" if close else f"there are: {', '.join(sorted(known)[:12]) or 'none'}"
        )
        yield Problem("event", entry, f"'{e.name}' {what}", remedy)
