"""Parameter sets (.ssv) and mappings (.ssm) of the bindings of an element."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from phfmu.fmu.words import plain
from phfmu.fmu.xml import Element, parse
from phfmu.ssp.names import NUMBERS, tag
from phfmu.ssp.package import Package, inside
from phfmu.ssp.schema import require_valid
from phfmu.ssp.structure import Binding, Linear, SSPError, Unit
from phfmu.ssp.units import read_units, undefined

_SET, _MAPPING = "application/x-ssp-parameter-set", "application/x-ssp-parameter-mapping"
_TRUTH = {"true": 1.0, "false": 0.0}


@dataclass(frozen=True)
class Source:
    """The origin of a description: its package, its name for messages, and `notes` of what is left out.

    `component`: file of the unit whose bindings are read;  `lenient`: units of measurement that are not defined are not known.
    """

    package: Package
    where: str
    notes: list[str]
    component: str = ""
    lenient: bool = False


def bindings(element: Element, source: Source) -> tuple[Binding, ...]:
    """Bindings of an element (system or component), of which the last counts most."""
    listed = element.find(tag("ssd", "ParameterBindings"))
    return tuple(_binding(b, source) for b in (() if listed is None else listed))


def _binding(element: Element, source: Source) -> Binding:
    root, where = document(element, tag("ssd", "ParameterValues"), "ssv", _SET, source)
    told = _values(root, where, source.notes, source.lenient)
    prefix = element.get("prefix", "")
    values, units = {prefix + n: v for n, v in told.values.items()}, {prefix + n: u for n, u in told.units.items()}
    mapping = element.find(tag("ssd", "ParameterMapping"))
    if mapping is None:
        return Binding(values, units)
    root, where = document(mapping, None, "ssm", _MAPPING, source)
    return _mapped(root, where, values, units)


def document(element: Element, inline: str | None, kind: str, type_: str, source: Source) -> tuple[Element, str]:
    """The document that a binding, mapping or dictionary names or holds (in its child `inline`, or itself), checked."""
    uri = element.get("source", "")
    if element.get("type", type_) != type_:
        raise SSPError(
            f"{source.where}: '{plain(uri, 200)}' is {plain(element.get('type', ''), 200)}; this reads {type_}"
        )
    if uri:
        where = f"{source.package.path}/{plain(uri, 200)}"
        if element.get("sourceBase", "SSD") == "SSD":
            root = parse(source.package.read(uri), where)
        elif source.component:
            where = f"{source.package.path}/{plain(source.component, 200)}/{plain(uri, 200)}"
            root = parse(inside(source.package.file(source.component), uri), where)
        else:
            raise SSPError(f"{source.where}: '{plain(uri, 200)}' is to be inside a unit, but a system binds it")
    else:
        holder, where = element if inline is None else element.find(inline), source.where
        if holder is None or not len(holder):
            raise SSPError(f"{source.where}: {element.tag.rpartition('}')[2]} has neither a source nor content")
        root = holder[0]
    if (line := require_valid(root, kind, where)) and line not in source.notes:
        source.notes.append(line)
    return root, where


def parameter_values(data: bytes, where: str, notes: list[str]) -> Binding:
    """The values of a parameter set (.ssv) by itself; lines about what is left out or not checked go to `notes`."""
    root = parse(data, where)
    if line := require_valid(root, "ssv", where):
        notes.append(line)
    return _values(root, where, notes, False)


def _values(root: Element, where: str, notes: list[str], lenient: bool) -> Binding:
    """Numbers by name, entries of vectors as name[1]; and the units of those that tell theirs."""
    known = read_units(root, "ssv")
    values: dict[str, float] = {}
    units: dict[str, Unit] = {}
    for p in root.find(tag("ssv", "Parameters")):
        name, value = plain(p.get("name", "")), p[0]
        kind = value.tag.rpartition("}")[2]
        if kind not in NUMBERS:
            notes.append(f"{where}: the parameter '{name}' is of the type {kind}; left out")
            continue
        numbers = [_number(t, where, name) for t in value.get("value", "").split()]
        names = [name] if len(numbers) == 1 else [f"{name}[{i}]" for i in range(1, len(numbers) + 1)]
        values |= dict(zip(names, numbers, strict=True))
        unit = value.get("unit", "")
        if unit in known:
            units |= dict.fromkeys(names, known[unit])
        elif unit:
            notes += undefined(f"{where}: the parameter '{name}'", unit, lenient)
    return Binding(values, units)


def _number(text: str, where: str, name: str) -> float:
    value = _TRUTH[text] if text in _TRUTH else float(text)
    if not isfinite(value):
        raise SSPError(f"{where}: the parameter '{name}' = {plain(text, 50)} is not finite")
    return value


def _mapped(root: Element, where: str, values: dict[str, float], units: dict[str, Unit]) -> Binding:
    """Only what the mapping names, under its new names."""
    new: dict[str, float] = {}
    kept: dict[str, Unit] = {}
    for entry in root.findall(tag("ssm", "MappingEntry")):
        name, target = plain(entry.get("source", "")), plain(entry.get("target", ""))
        if name not in values:
            raise SSPError(f"{where}: the mapping takes '{name}', which the parameter set does not have")
        linear = Linear()
        for e in entry:
            kind = e.tag.rpartition("}")[2]
            if kind == "LinearTransformation":
                linear = Linear(float(e.get("factor", "1")), float(e.get("offset", "0")))
            elif kind != "Annotations":
                raise SSPError(f"{where}: the mapping of '{name}' has a {kind}, which is not read; use a linear one")
        new[target] = linear(values[name])
        if name in units and entry.get("suppressUnitConversion", "") not in ("true", "1"):
            kept[target] = units[name]
    return Binding(new, kept)
