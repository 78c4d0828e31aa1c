"""Units of SSP: definitions read and written, and what lies between values in two of them."""

from __future__ import annotations

from collections.abc import Mapping
from math import isclose, isfinite

from phfmu.declare.expressions.units import BASE, UnitError, parse_unit
from phfmu.declare.expressions.units import PhysicalUnit as Defined
from phfmu.fmu.words import plain
from phfmu.fmu.xml import Element, etree, number
from phfmu.ssp.names import tag
from phfmu.ssp.structure import Linear, SSPError, Unit


def read_units(root: Element, kind: str) -> dict[str, Unit]:
    """Units of a document (`kind`: ssd, ssv) by name."""
    listed = root.find(tag(kind, "Units"))
    return {u.get("name", ""): _read(u) for u in (() if listed is None else listed)}


def _read(element: Element) -> Unit:
    base, name = element.find(tag("ssc", "BaseUnit")), plain(element.get("name", ""), 100)
    factor, offset = float(base.get("factor", "1")), float(base.get("offset", "0"))
    if not (isfinite(factor) and factor > 0 and isfinite(offset)):
        raise SSPError(
            f"unit '{name}' has the factor {factor:g} and the offset {offset:g}; they must be finite, factors positive"
        )
    return Unit(name, factor, offset, tuple(int(base.get(b, "0")) for b in BASE))


def undefined(what: str, unit: str, lenient: bool, close: str = "") -> list[str]:
    """A line about `what`, whose unit of measurement the document does not define: it counts as not told.

    SSPError with the remedy unless that is asked for (`lenient`); `close`: what may have been meant.
    """
    words = f"{what} is in '{plain(unit, 100)}', which Units does not define"
    if not lenient:
        raise SSPError(f"{words}; {close}{'. ' if close else ''}--lenient goes on, with values taken as they are")
    return [f"{words}; its values are taken as they are"]


def named(text: str) -> Unit | None:
    """The unit that a unit text of this package or of an FMU means; None where it is no unit or cannot be read."""
    if not text or text == "1":
        return None
    try:
        found = parse_unit(text)
    except UnitError:
        return None
    return Unit(text, found.factor, 0.0, found.exponents)


def write_units(parent: Element, kind: str, used: Mapping[str, Defined]) -> None:
    """`Units` with the definitions of the units in use, by name; nothing without any."""
    if not used:
        return
    listed = etree.SubElement(parent, tag(kind, "Units"))
    for text, unit in sorted(used.items()):
        base = etree.SubElement(etree.SubElement(listed, tag("ssc", "Unit"), name=text), tag("ssc", "BaseUnit"))
        for symbol, exponent in zip(BASE, unit.exponents, strict=True):
            if exponent:
                base.set(symbol, str(exponent))
        if unit.factor != 1.0:
            base.set("factor", number(unit.factor))


def conversion(a: Unit | None, b: Unit | None, what: str) -> Linear:
    """The linear map of values in a to values in b, `what` in words; the identity where one is not told.  rad counts as 1.

    SSPError if they are not of one kind.
    """
    if a is None or b is None:
        return Linear()
    if a.exponents[:-1] != b.exponents[:-1]:
        raise SSPError(f"{what}: unit mismatch: '{a.name}' ({_base(a)}) cannot become '{b.name}' ({_base(b)})")
    if isclose(a.factor, b.factor, rel_tol=1e-12) and a.offset == b.offset:
        return Linear()
    return Linear(a.factor / b.factor, (a.offset - b.offset) / b.factor)


def _base(unit: Unit) -> str:
    parts = [f"{b}{e if e != 1 else ''}" for b, e in zip(BASE, unit.exponents, strict=True) if e]
    return ".".join(parts) or "1"
