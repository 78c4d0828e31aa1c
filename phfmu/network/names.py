"""Column names of a model's signals: the same names as in its FMU."""

from __future__ import annotations

from phfmu.discretise.model import Model


def suffixed(name: str, suffix: str) -> str:
    """`lambda[1]` -> `lambda_end[1]`: the suffix goes before the index."""
    base, bracket, index = name.partition("[")
    return f"{base}{suffix}{bracket}{index}"


def check_name(name: str, level: str) -> str:
    """Name of a hidden-constraint residual of the multiplier or node variable `name`."""
    return f"constraint.{level}.{name}"


def signal_names(model: Model) -> dict[str, list[str]]:
    """Per signal block the name of each entry; entries without a place in a result file are ""."""
    d = model.declaration
    states = [n for v in d.states for n in v.names()]
    algebraics = [n for v in d.algebraics for n in v.names()]
    external = [p for p in d.ports if p.external]
    ports = external + [p for p in d.ports if not p.external]
    pair_energy = [suffixed(n, "_energy") for p in ports for n in p.output_names()]
    members = [f"{m}." if m else "" for m in model.members]
    return {
        "x": states,
        "time": ["time"],
        "a": algebraics,
        "y_step": [n for p in ports for n in p.output_names("_step")],
        "energy": pair_energy,
        "supplied": [f"{m}energy.supplied" for m in members],
        "dissipated": [f"{m}energy.dissipated" for m in members],
        "residual": [f"{m}energy.residual" for m in members],
        "a_end": [suffixed(n, "_end") for n in algebraics],
        "y_end": [n for p in ports for n in p.output_names()],
        "observables": list(model.observable_names) + [check_name(c.name, c.level) for c in model.checks],
        "H": [f"{m}energy.stored" for m in members],
    }
