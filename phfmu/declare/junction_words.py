"""Messages for violated junction equations, in the words of their ports."""

from __future__ import annotations

from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port, conjugate


def junction_words(declaration: PHDAE, unknown: str, value: float) -> str:
    """The row of the junction unknown `unknown` (scalar name) of a composed model that is off by `value`, "" if it is none.

    The row of a common variable sums the other one of the pair; that of a port's input says that the port gives the common
    variable.
    """
    begins = unknown.partition("[")[0]
    fed = next((p for p in declaration.ports if unknown in p.input_names()), None)
    for junction, ends in declaration.junctions:
        if begins.startswith(f"{junction}.") and (
            first := next((p for p in declaration.ports if p.name in ends), None)
        ):
            effort, flow = first.domain.effort, first.domain.flow
            for shared, other in ((effort, flow), (flow, effort)):
                if begins == f"{junction}.{shared}":
                    return f"{other} of {listed(ends)} sum to {value:.6g} {_unit(first, other)}"
        if fed is not None and fed.name in ends:
            return spread_words(fed, ends, value)
    return ""


def spread_words(port: Port, ends: tuple[str, ...], value: float) -> str:
    """The common variable that the ports `ends`, of which one is `port`, give differently."""
    common = port.domain.word(conjugate(port.given))
    return f"{common} of {listed(ends)} differ by {abs(value):.6g} {_unit(port, common)}"


def listed(ends: tuple[str, ...]) -> str:
    *others, last = ends
    return f"{', '.join(others)} and {last}" if others else last


def _unit(port: Port, what: str) -> str:
    return port.domain.effort_unit if what == port.domain.effort else port.domain.flow_unit
