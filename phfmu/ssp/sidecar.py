"""The file beside a unit that tells its ports, written: what `phfmu.fmu.port_tables` reads."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict

from phfmu.declare.port import Given, conjugate
from phfmu.declare.units import UnitError, parse_unit, unit_text
from phfmu.fmu.manifest import PortMap


def sidecar_text(ports: Iterable[PortMap]) -> str:
    """TOML with a table per port."""
    return "\n".join(_table(p) for p in ports)


def _scaled(unit: str, factor: float) -> str:
    """`factor` times a unit as a text, e.g. kN; empty where there is none: the unit's own definitions tell it then."""
    known = parse_unit(unit)
    text = unit_text(known.without_angle(), factor * known.factor)
    try:
        parse_unit(text)
    except UnitError:
        return ""
    return text


def _table(p: PortMap) -> str:
    effort, flow = (p.inputs, p.outputs) if p.given == "effort" else (p.outputs, p.inputs)
    told = {"effort": effort, "flow": flow, "displacement": p.displacements}
    # text and lists of text are written alike in JSON and TOML; without a list a port is a scalar
    lines = [f"{k} = {json.dumps(v if p.vector or len(v) > 1 else ''.join(v))}" for k, v in told.items() if v]
    factors: dict[Given, float] = {p.given: p.input_factor, conjugate(p.given): p.output_factor}
    for member, factor in factors.items():
        if factor != 1.0 and (text := _scaled(p.domain.unit(member), factor)):
            lines.append(f"{member}_unit = {json.dumps(text)}")
    domain = ", ".join(f"{k} = {json.dumps(v)}" for k, v in asdict(p.domain).items())
    return "\n".join([f"[{p.name}]", *lines, f"sign = {int(p.sign)}", f"domain = {{ {domain} }}", ""])
