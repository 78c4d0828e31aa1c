"""Ports whose flow counts out of the unit, as tools want it that connect variables plainly.

Of a pair one variable is equal on both sides of a connection, the other sums to zero there: voltage and current, but
velocity and force.  Power is positive into the component, so the second changes its sign on the way from one unit to the
other; at an outward port it is counted positive out of the unit already (`outflow` in the words of FMI 3.0).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.fmu.export.variables import FMUError, FMUVariable
from phfmu.words import meant


def summed_word(port: Port) -> str:
    """Name of that variable in the port: current i, force."""
    return port.domain.word(port.domain.summed)


def require_ports(declaration: PHDAE, outward: Sequence[str]) -> None:
    """FMUError names what is no external port of the declaration."""
    free = [p.name for p in declaration.ports if p.external and not p.signal]
    for name in outward:
        if name not in free:
            raise FMUError(
                f"{declaration.name} has no free port '{name}' that could count outward; {meant(name, free)}"
            )


def turned(table: Sequence[FMUVariable], ports: Sequence[Port]) -> tuple[FMUVariable, ...]:
    """The variables, of which those that sum to zero at `ports` count out of the unit."""
    bases = [f"{p.name}.{summed_word(p)}" for p in ports]
    return tuple(_turned(v) if any(_of(v.name, base) for base in bases) else v for v in table)


def _of(name: str, base: str) -> bool:
    """terminal.i, terminal.i[1], terminal.i_step, terminal.i_node[1,2] are all of terminal.i."""
    bare = name.partition("[")[0]
    return bare == base or bare.startswith(f"{base}_")


def _turned(v: FMUVariable) -> FMUVariable:
    start = -v.start if v.start else v.start  # no -0
    return replace(v, sign=-v.sign, start=start, description=f"{v.description}; positive out of the unit")
