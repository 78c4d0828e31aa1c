"""The rule on values of parameters."""

from __future__ import annotations

from phfmu.checks.sample import Sample
from phfmu.declare.entries import Entries
from phfmu.declare.parameter_limits import declared_limits, limits_of
from phfmu.declare.problem import Problem


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
