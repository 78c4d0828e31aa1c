"""Export of a network whose members stay apart as Functional Mock-up Units."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from phfmu.fmu.export.export import host_platform, rows_of, written
from phfmu.fmu.export.schedule import UnitEvent
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.version import VERSIONS, Version
from phfmu.network.as_unit.embedded import require_embeddable, untold
from phfmu.network.as_unit.unit import coupled_members, network_unit, with_fed_inside
from phfmu.network.couplings.choice.coupling_choice import named_coupling, repeats
from phfmu.network.couplings.coupling_table import NEWTON
from phfmu.network.members.unit_member import tried
from phfmu.network.network import Network
from phfmu.schemes.scheme import Scheme
from phfmu.signals import of_member
from phfmu.words import meant


def export_network(
    network: Network,
    directory: str | Path,
    schemes: Mapping[str, Scheme],
    versions: Sequence[str | Version] = tuple(VERSIONS),
    *,
    step: float,
    stop: float | None = None,
    platforms: Sequence[str] | None = None,
    ledger_outputs: bool = True,
    terminals: bool = True,
    left_out: Sequence[str] = (),
    arrays: bool = False,
    outward: Sequence[str] = (),
    tunable: Collection[str] = (),
    events: Sequence[UnitEvent] = (),
    coupling: str = NEWTON.name,
    sequence: Sequence[str] | None = None,
) -> list[Path]:
    """Write a network as units whose members are stepped apart, each by its scheme, and joined by a coupling inside.

    Members that are units of other tools are inside with their files; saved states and platforms are those that all of them have.
    `coupling`, `sequence`: its name, and of members that step in turn their order;
    `tunable`, `events`, `outward`: of members, `member.name`; all else as of `export`.  Errors: FMUError for members that the
    master inside does not step: units of this package, units that cannot be inside another one, state events, signals held over
    steps.  Raises ValueError for an unknown coupling.
    """
    rows = rows_of(versions)
    network = with_fed_inside(network, [e.name for e in events])
    joined_by = named_coupling(coupling, network, sequence)
    require_embeddable(network, [host_platform()] if platforms is None else platforms)
    found = tried(network.units, step) if network.units and repeats(coupling) else {}
    whole, models = coupled_members(network, joined_by, schemes, step, found)
    parameters = [(of_member(name, ""), v) for name, d in network.declared.items() for v in d.parameters]
    known = {at + n: [at + n] for at, v in parameters for n in v.names()}
    known |= {at + v.name: [at + n for n in v.names()] for at, v in parameters}
    if lost := [n for n in [*tunable, *(e.name for e in events)] if n not in known]:
        raise FMUError(f"{network.name} has no parameter '{lost[0]}' to be tunable; {meant(lost[0], known)}")
    scalars = frozenset(n for name in [*tunable, *(e.name for e in events)] for n in known[name])
    ordered = sorted(events, key=lambda e: e.t)
    inside = tuple(UnitEvent(e.t, n, e.value) for e in ordered for n in known[e.name])
    unit = network_unit(
        network, joined_by, whole, models, step=step, stop=stop, ledger_outputs=ledger_outputs, terminals=terminals,
        left_out=(*left_out, *untold_of(network)), arrays=arrays, outward=tuple(outward), tunable=scalars, events=inside,
    )  # fmt: skip
    return written(unit, directory, rows, platforms)


def untold_of(network: Network) -> list[str]:
    """Lines about what the unit of a network does not tell of units inside."""
    return [f"{name}: {line}" for name, file in network.units.items() for line in untold(file)]
