"""The check of the numbers of one run and of their units: settings, starts and what events make of the parameters.

It is the part of `check` that is cheap and that a closed ledger may hide: limits of parameters, finite starts, J skew, R
symmetric and semidefinite, E regular, all evaluated at once from one set of compiled expressions; H without jumps.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import casadi as ca
import numpy as np

from phfmu.checks.matrices import finite, masses, passivity, skew_symmetry, symmetry
from phfmu.checks.names import ranges, units
from phfmu.checks.pieces import continuous
from phfmu.checks.sample import Sample, Setting
from phfmu.declare.entries.alike import first_alike
from phfmu.declare.entries.entries import Entries, Entry, normal_form
from phfmu.declare.entries.entry_kind import EntryKind
from phfmu.declare.entries.starts import starts
from phfmu.declare.error import Problem
from phfmu.declare.phdae import PHDAE


class ValueChange(Protocol):
    """An event: at time t the parameter or input `name` takes `value`."""

    @property
    def t(self) -> float: ...
    @property
    def name(self) -> str: ...
    @property
    def value(self) -> float: ...


def check_values(
    model: PHDAE, values: Mapping[str, float] | None = None, events: Sequence[ValueChange] = ()
) -> list[Problem]:
    """Problems of `model` with the start values `values` (as `with_starts`) and the parameter values of `events`.

    Told as by `check`; expressions that are not sound are left to it.  Cheap (some ms): for many runs of one model.
    Of the values that events give a parameter those beyond all before them are checked.  KeyError for unknown names.
    """
    model = model.with_starts(values) if values else model
    found = [*starts(model), *units(model)]
    return found or _at(model, settings(model, events))


def sound_members(members: Iterable[PHDAE]) -> bool:
    """Whether `check_values` finds nothing in any of them.

    Those that are alike and start in the same state are looked at once, with the parameters of each as settings of one model.
    """
    kinds: dict[tuple[PHDAE, bytes], tuple[PHDAE, dict[tuple[float, ...], None]]] = {}
    for m in members:
        if starts(m):
            return False
        at = [s for v in (*m.states, *m.algebraics) for s in v.start] + [s for p in m.ports for s in p.input_starts()]
        one = kinds.setdefault((first_alike(m), np.array(at, float).tobytes()), (m, {}))
        one[1][tuple(s for v in m.parameters for s in v.start)] = None
    return not any(units(m) or _at(m, [Setting(p) for p in values]) for m, values in kinds.values())


def _at(model: PHDAE, given: Sequence[Setting]) -> list[Problem]:
    """Problems with parameters as given, one after the other."""
    entries, found = Entries(model), list[Problem]()
    normal_form(entries)
    # numbers do not change with the run: looked at where others are added to them, or where they are not skew
    entries.sound = [
        e for e in entries.sound if e.what in (EntryKind.R, EntryKind.E) or ca.symvar(e.expr) or _not_skew(e)
    ]
    sample = Sample(entries, given)
    for rule in (ranges, finite, skew_symmetry, symmetry, passivity, masses, continuous):
        found += rule(entries, sample)
    return found


def _not_skew(entry: Entry) -> bool:
    return entry.what is EntryKind.J and not (entry.expr + entry.expr.T).is_zero()


def settings(model: PHDAE, events: Sequence[ValueChange]) -> list[Setting]:
    """The parameters at the start, then each time an event takes one beyond its values before."""
    names = [n for v in model.parameters for n in v.names()]
    place = {n: [i] for i, n in enumerate(names)}
    for v in model.parameters:
        place.setdefault(v.name, [i for n in v.names() for i in place[n]])
    now = [s for v in model.parameters for s in v.start]
    low, high = list(now), list(now)
    found = [Setting(tuple(now))]
    for e in sorted((e for e in events if e.name in place and np.isfinite(e.value)), key=lambda e: e.t):
        beyond = any(not low[i] <= e.value <= high[i] for i in place[e.name])
        for i in place[e.name]:
            now[i] = e.value
            low[i], high[i] = min(low[i], e.value), max(high[i], e.value)
        if beyond and e.t <= 0.0 and len(found) == 1:
            found = [replace(found[0], parameters=tuple(now))]
        elif beyond:
            found.append(Setting(tuple(now), f"after the event {e.name} = {e.value:g} at t = {e.t:g} s"))
    return found
