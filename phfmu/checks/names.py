"""Rules on what is declared: names, units, nominal values.

The rule on values of parameters.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from phfmu.checks.sample import Sample
from phfmu.declare.entries.entries import Entries
from phfmu.declare.entries.model_name import model_name
from phfmu.declare.entries.parameter_limits import declared_limits, limits_of
from phfmu.declare.entries.starts import variables
from phfmu.declare.error import Problem
from phfmu.declare.expressions.units import UnitError, is_power, parse_unit
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port

#: a structured name of FMI: identifiers joined by dots
_NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*", re.ASCII)
_LEDGER = ("stored", "supplied", "dissipated", "residual")


def names(model: PHDAE) -> list[Problem]:
    """Names are structured and unique among variables, ports, observables, members; owners are members."""
    once = {v.sx[0].element_hash(): v for v, _ in variables(model)} | {p.u[0].element_hash(): p for p in model.ports}
    declared = [(f"{'port' if isinstance(v, Port) else 'variable'} '{v.name}'", v.name) for v in once.values()]
    declared += [(f"observable '{o.name}'", o.name) for o in model.observables]
    declared += [(f"guard '{e.guard.name}'", e.guard.name) for e in model.state_events]
    declared += [(f"member '{m}'", m) for m in model.members if m]
    declared += [(f"junction '{j}'", j) for j, _ in model.junctions]
    found = []
    for entry, name in declared:
        if not _NAME.fullmatch(name):
            text, remedy = (
                f"'{name}' is not a structured name",
                "write identifiers joined by dots, e.g. gen.psi_d",
            )
            found.append(Problem("name", entry, text, remedy))
    twice = _repeated(declared)
    for name, (n, entries) in twice.items():
        found.append(Problem("name", entries, f"'{name}' is used {n} times", "give each entry a name of its own"))
    if len(once) < len(list(variables(model))) + len(model.ports):
        return found  # entries listed twice repeat all of their signals
    clear = [(entry, name) for whose, entry, name in _signals(model) if whose not in twice]
    for name, (n, entries) in _repeated(clear).items():
        text = f"{n} reported signals are called '{name}'"
        found.append(Problem("name", entries, text, "rename one of them"))
    return found + _owners(model) + model_name(model)


def _repeated(named: list[tuple[str, str]]) -> dict[str, tuple[int, str]]:
    """name -> (how often, the entries) of the names that occur more than once."""
    where: dict[str, list[str]] = {}
    for entry, name in named:
        where.setdefault(name, []).append(entry)
    return {name: (len(e), ", ".join(dict.fromkeys(e))) for name, e in where.items() if len(e) > 1}


def _signals(model: PHDAE) -> Iterator[tuple[str, str, str]]:
    """(what it belongs to, entry, name) of every reported scalar."""
    yield "time", "the 'time'", "time"
    for member in model.members:
        for what in _LEDGER:
            yield member, f"the ledger of '{member}'", f"{member}.energy.{what}" if member else f"energy.{what}"
    for v, entry in variables(model):
        for name in v.names():
            yield v.name, f"variable '{v.name}'", name
            if entry == "algebraics":
                base, bracket, index = name.partition("[")
                yield v.name, f"value of '{v.name}' at the end of a step", f"{base}_end{bracket}{index}"
    for port in model.ports:
        given = port.input_names() if port.external else []
        for name in (*given, *port.output_names(), *port.output_names("_step"), f"{port.name}.energy"):
            yield port.name, f"port '{port.name}'", name
    for o in model.observables:
        n = o.expr.numel()
        for name in [o.name] if n == 1 else [f"{o.name}[{j + 1}]" for j in range(n)]:
            yield o.name, f"observable '{o.name}'", name


def _owners(model: PHDAE) -> list[Problem]:
    """Whatever is booked in the ledger belongs to a member."""
    booked = [(f"energy term {i + 1}", e.owner) for i, e in enumerate(model.energies)]
    booked += [(f"R block on {', '.join(v.name for v in b.variables)}", b.owner) for b in model.dissipation]
    booked += [(f"port '{p.name}'", p.owner) for p in model.ports]
    booked += [(f"closed-form pair {i + 1}", c.owner) for i, c in enumerate(model.closed)]
    booked += [(f"jump '{e.guard.name}'", e.jump.owner) for e in model.state_events if e.jump is not None]
    there = ", ".join(f"'{m}'" for m in model.members)
    return [
        Problem("name", entry, f"its owner '{owner}' is not a member", f"use one of the members: {there}")
        for entry, owner in booked
        if owner not in model.members
    ]


def shared_symbols(model: PHDAE) -> list[Problem]:
    """Each symbol is declared once; without that no expression can be evaluated."""
    found, seen = [], {}
    declared = [(f"variable '{v.name}'", v.sx) for v, _ in variables(model)]
    declared += [(f"port '{p.name}'", p.u) for p in model.ports]
    for entry, symbols in declared:
        first = seen.setdefault(symbols[0].element_hash(), entry)
        if first is not entry:
            what = "is listed twice" if first == entry else f"has the symbols of {first}"
            found.append(Problem("name", entry, what, "list each variable once, under one role"))
    return found


def units(model: PHDAE) -> list[Problem]:
    """Units are known and effort times flow of every port is a power."""
    found = []

    def unknown(entry: str, unit: str) -> bool:
        try:
            parse_unit(unit)
        except (UnitError, TypeError, AttributeError) as e:
            found.append(Problem("unit", entry, str(e), "write SI symbols with exponents, e.g. kg.m2/s"))
            return True
        return False

    for v, _ in variables(model):
        unknown(f"variable '{v.name}'", v.unit)
    for o in model.observables:
        unknown(f"observable '{o.name}'", o.unit)
    for e in model.state_events:
        unknown(f"guard '{e.guard.name}'", e.guard.unit)
    for port in model.ports:
        d = port.domain
        pair = (
            (f"{d.name} effort of port '{port.name}'", d.effort_unit),
            (f"{d.name} flow of port '{port.name}'", d.flow_unit),
        )
        if any([unknown(entry, unit) for entry, unit in pair]):
            continue
        if not is_power(d.effort_unit, d.flow_unit):
            e, f = parse_unit(d.effort_unit), parse_unit(d.flow_unit)
            exponents = [a + b for a, b in zip(e.without_angle(), f.without_angle(), strict=True)]
            found.append(
                Problem(
                    "unit", f"port '{port.name}'",
                    f"effort [{d.effort_unit}] times flow [{d.flow_unit}] is "
                    f"{e.factor * f.factor:g} times SI units with exponents {exponents} of kg, m, s, A, K, "
                    "mol, cd; a power has factor 1 and [1, 2, -3, 0, 0, 0, 0]",
                    "use a conjugate pair whose product is the watt, e.g. V and A, N and m/s",
                )
            )  # fmt: skip
    return found


def nominals(model: PHDAE) -> list[Problem]:
    """Nominal values are positive and finite."""
    values = [(f"variable '{v.name}'", v.nominal) for v, entry in variables(model) if entry != "parameters"]
    values += [(f"port '{p.name}'", p.nominal) for p in model.ports]
    values += [(f"guard '{e.guard.name}'", e.guard.nominal) for e in model.state_events]
    found = []
    for entry, value in values:
        array = np.atleast_1d(np.asarray(value, float))
        bad = array[~((array > 0) & np.isfinite(array))]
        if bad.size:
            found.append(
                Problem(
                    "nominal",
                    entry,
                    f"nominal = {bad[0]:g}",
                    "give the typical magnitude, positive and finite",
                )
            )
    return found


def ranges(entries: Entries, sample: Sample) -> list[Problem]:
    """Parameters are within their limits, declared or derived; each is told once, at its first value outside."""
    variables = entries.model.parameters
    positive = all(value > 0 for s in sample.settings for value in s.parameters)
    limits = declared_limits(entries.model) if positive else limits_of(entries)
    found: dict[str, Problem] = {}
    scalars = [(name, v.unit) for v in variables for name in v.names()]
    for setting in sample.settings:
        for (name, unit), value in zip(scalars, setting.parameters, strict=True):
            limit = limits.get(name)
            if limit is None or limit.allows(value) or name in found:
                continue
            text = f"is {value:g}{'' if unit == '1' else ' ' + unit}{' ' * bool(setting.since)}{setting.since}"
            why = f" ({limit.because})" if limit.because else ""
            remedy = f"give {name} a value {limit}" + (", or declare min=-inf if this is meant" if limit.waived else "")
            found[name] = Problem("limit", f"parameter '{name}'", f"{text}; it must be {limit}{why}", remedy)
    return list(found.values())
