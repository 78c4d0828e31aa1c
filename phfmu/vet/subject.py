"""The unit that is vetted: how long its trials are, which inputs they move, and instances that are stepped and read.

The trials call the unit by the functions of the standard, without what this package keeps beside its own units, so that all units
are treated alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.fmu.importer.archive import Archive, open_archive
from phfmu.fmu.importer.bindings import able
from phfmu.fmu.importer.slave import AnySlave
from phfmu.fmu.importer.unit_file import unit_file
from phfmu.fmu.importer.unit_interface import Scalar, UnitInterface
from phfmu.fmu.isolation.remote_slave import slave_of
from phfmu.vet.declared import DeclaredAttributes, declared

Array = NDArray[np.float64]

#: communication steps of a trial, before which inputs are at their start values for a few
STEPS, QUIET = 48, 4
#: of an input: by how much it is moved, relative to its start and nominal value
MOVE = 0.1
#: steps of an experiment that tells none, or less than so many
PARTS, SHORTEST = 500, 12
#: s in which a call in a process of its own answers
PATIENCE = 20.0


@dataclass
class Subject:
    """A unit for Co-Simulation: `h` (s) and `t0` of its trials; `deadline` (monotonic s) of the claim that is tried.

    `amplitude`: of the moved inputs, 0 where the unit refuses them.  `pace`: s that a step takes, once it is known.
    """

    path: Path
    deadline: float = field(default_factory=lambda: monotonic() + 60.0)
    amplitude: float = 1.0
    pace: float = 0.0

    @cached_property
    def archive(self) -> Archive:
        return open_archive(self.path)

    @property
    def interface(self) -> UnitInterface:
        return self.archive.interface

    @cached_property
    def declared(self) -> DeclaredAttributes:
        return declared(self.path, self.interface.version)

    @cached_property
    def ports(self) -> tuple[Any, ...]:
        """Power ports of a file beside it, its manifest or its terminals."""
        return unit_file(self.path).port_maps

    @property
    def t0(self) -> float:
        return self.interface.start

    @cached_property
    def h(self) -> float:
        """The communication step: that of the experiment, of the unit inside, or a part of its span."""
        step = self.interface.step or self.inside
        if step and (self.inside or self.span is None or self.span >= SHORTEST * step):
            return step
        return 1e-3 if self.span is None else self.span / PARTS

    @property
    def inside(self) -> float | None:
        """Length of the steps that it takes inside (fixedInternalStepSize), of which its steps are multiples."""
        told = self.declared.abilities.get("fixedInternalStepSize")
        return float(told) if told else None

    @property
    def span(self) -> float | None:
        """Length of its experiment (s), if it tells one."""
        about = self.interface
        return about.stop - about.start if about.stop is not None and about.stop > about.start else None

    @cached_property
    def n(self) -> int:
        """Steps of a trial: no more than the experiment has."""
        return STEPS if self.span is None else max(2, min(STEPS, int(self.span / self.h + 1e-6)))

    @cached_property
    def inputs(self) -> list[Scalar]:
        """Inputs of type real that trials move; those at the nodes of a step and impulses are left alone."""
        about = self.interface
        left = {n for p in about.ports for group in (*p.node_inputs, *p.impulses) for n in group}
        left |= {n for names in about.taken.values() for n in names}
        return [
            v
            for v in about.variables.values()
            if v.causality == "input" and v.type in ("Float64", "Float32") and v.name not in left
        ]

    @cached_property
    def told(self) -> list[Scalar]:
        """Outputs and local variables: what is compared."""
        return [v for v in self.interface.variables.values() if v.causality in ("output", "local")]

    def values(self, k: int, stretch: float = 1.0) -> Array:
        """Inputs in step k of the trials: a fixed sum of sines about their starts, within their limits."""
        places = np.arange(1, len(self.inputs) + 1)
        x = k * stretch
        wave = 0.0 if x < QUIET else np.sin(0.7 * (x - QUIET) + places) + 0.5 * np.sin(2.9 * (x - QUIET) * places)
        return np.clip(self.starts + self.amplitude * MOVE * self.scale * wave, *self._limits)

    @cached_property
    def starts(self) -> Array:
        return np.array([v.start or 0.0 for v in self.inputs])

    @cached_property
    def scale(self) -> Array:
        """Size of an input: its start value and its nominal one."""
        return np.array([abs(v.start or 0.0) + abs(v.nominal) for v in self.inputs])

    @cached_property
    def _limits(self) -> tuple[Array, Array]:
        told = [self.declared.limits.get(v.name.partition("[")[0], (None, None)) for v in self.inputs]
        low = np.array([-np.inf if a is None else a for a, _ in told])
        return low, np.array([np.inf if b is None else b for _, b in told])

    def clipped(self, u: Array) -> Array:
        """Inputs within the limits that the description declares."""
        return np.clip(u, *self._limits)

    def left(self) -> float:
        """s until the claim has to be judged."""
        return self.deadline - monotonic()

    @contextmanager
    def trial(self, process: bool = False, begin: bool = True, name: str = "") -> Iterator[UnitTrial]:
        """An instance, at its start unless `begin` is false; in a process of its own if asked."""
        slave = slave_of(self.archive.extracted, name or "vetted", False, PATIENCE if process else None)
        trial = UnitTrial(self, slave)
        try:
            if begin:
                trial.begin()
            yield trial
        finally:
            trial.close()

    @property
    def alone(self) -> bool:
        """A process can have one instance of it."""
        return self.interface.one_instance


class UnitTrial:
    """An instance of the unit, stepped on the grid t0 + k h; `ended`: it has asked to end the simulation."""

    def __init__(self, subject: Subject, slave: AnySlave):
        self.subject, self.slave, self.ended, self.time = subject, slave, False, subject.t0
        self.interface = able(subject.interface, slave.absent)
        self.u = slave.references(subject.inputs)
        self.y = slave.references(subject.told)
        self._held = dict[int, tuple[Any, float]]()

    def begin(self) -> None:
        """Through initialisation, with start values as they are."""
        subject = self.subject
        self.slave.enter(subject.t0, None, None)
        self.slave.leave()
        self.ended, self.time = False, subject.t0

    def give(self, u: Array) -> None:
        """Inputs, from now on."""
        self.u.values[:] = u
        self.slave.set(self.u)

    def step(self, k: int, h: float | None = None, stretch: float = 1.0) -> None:
        """Step k of length h under its inputs; times are t0 + k h, never summed."""
        h = self.subject.h if h is None else h
        if self.subject.inputs:
            self.give(self.subject.values(k, stretch))
        self.advance(self.subject.t0 + k * h, h)

    def advance(self, t: float, h: float) -> None:
        """A step under inputs as they are; the unit is told whether a state of an earlier time is held."""
        prior = any(time < t - 1e-6 * h for _, time in self._held.values())
        self.time, self.ended = self.slave.do_step(t, h, not prior)

    def read(self) -> Array:
        """Outputs and local variables now."""
        return self.slave.get(self.y).copy()

    def run(self, first: int, last: int) -> Array:
        """Values after each of the steps first <= k < last; fewer rows where the unit asks to end or time is up."""
        rows = list[Array]()
        for k in range(first, last):
            self.step(k)
            rows.append(self.read())
            if self.ended or self.subject.left() < 0:
                break
        return np.array(rows).reshape(len(rows), self.y.n)

    def save(self) -> int:
        """A number for the state now."""
        handle = self.slave.save()
        number = len(self._held) + 1
        self._held[number] = handle, self.time
        return number

    def keep(self, data: bytes) -> int:
        """A number for a state of bytes."""
        number = len(self._held) + 1
        self._held[number] = self.slave.deserialize(data), self.time
        return number

    def restore(self, number: int, time: float | None = None) -> None:
        handle, then = self._held[number]
        self.slave.restore(handle)
        self.time, self.ended = then if time is None else time, False

    def bytes_of(self, number: int) -> bytes:
        return self.slave.serialize(self._held[number][0])

    def close(self) -> None:
        """Free its states, then the instance."""
        if self.slave.dead:
            return
        for handle, _ in self._held.values():
            self.slave.forget(handle)
        self.slave.free()


def difference(names: Sequence[Scalar], first: Array, other: Array) -> str:
    """The first place in which two tables of values differ in a bit, in words; empty if there is none."""
    n = min(len(first), len(other))
    if not n:
        return "" if len(first) == len(other) else "one has no step"
    a, b = first[:n], other[:n]
    same = (a.view(np.uint64) == b.view(np.uint64)) | (np.isnan(a) & np.isnan(b))
    if same.all():
        return "" if len(first) == len(other) else f"one ends after {n} steps"
    k, i = np.argwhere(~same)[0]
    apart = abs(a[k, i] - b[k, i]) / max(abs(a[k, i]), abs(b[k, i]), np.finfo(float).tiny)
    return f"{names[i].name} = {b[k, i]:.9g}, not {a[k, i]:.9g}, after {k + 1} of {n} steps (relative {apart:.1g})"
