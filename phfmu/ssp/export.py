"""Export of a scene as a package of SSP: each member becomes a unit in it."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from phfmu.declare.phdae import PHDAE
from phfmu.discretise.model import build_model
from phfmu.fmu.export.export import export
from phfmu.fmu.importer.unit_file import UnitFile, unit_file
from phfmu.network.junction import End
from phfmu.network.network import Network
from phfmu.network.scene import Scene
from phfmu.schemes.scheme import Scheme
from phfmu.ssp.bonds import joins_plainly
from phfmu.ssp.flat import identifier
from phfmu.ssp.names import DRAFT, VERSIONS
from phfmu.ssp.round_trip import RoundTripContent
from phfmu.ssp.structure import SSPError
from phfmu.ssp.writing import Contents, write_package
from phfmu.words import meant


@dataclass(frozen=True)
class PackageOptions:
    """Options of the export of units: step, s; FMI version; platforms as in `phfmu.fmu.export.export`; `schemes`: by member;
    `outward`: ports (`member.port`) whose flow counts out of their unit."""

    step: float
    fmi: str = "2.0"
    platforms: Sequence[str] | None = None
    schemes: Mapping[str, Scheme] = field(default_factory=dict)
    outward: Sequence[str] = ()


def network_of(scene: Scene) -> Network:
    """The network of a scene; a single component becomes its only member."""
    if isinstance(scene.system, Network):
        return scene.system
    net = Network(identifier(scene.name), description=scene.description)
    net.add(identifier(scene.system.name), scene.system)
    return net


def export_ssp(
    scene: Scene, directory: str | Path, options: PackageOptions, version: str = "1.0"
) -> tuple[Path, list[str]]:
    """Write `<name>.ssp` of SSP `version`; its path, and lines about what other tools will not find in it.

    Errors: SSPError; FMUError and those of the compiler for a member that cannot be exported.
    """
    if version not in VERSIONS:
        raise SSPError(f"SSP version '{version}'; known: {', '.join(VERSIONS)}")
    net = network_of(scene)
    outward = _outward(net, _turned(net, options.outward) if version == DRAFT else options.outward)
    path = Path(directory) / f"{net.name}.ssp"
    with tempfile.TemporaryDirectory(prefix="phfmu-") as folder:
        units = replace(net, members={})
        for name in net.members:
            units.add(name, _unit(net, name, Path(folder), options, outward[name]))
        kept = (scene.kept if isinstance(scene.kept, RoundTripContent) else RoundTripContent()).of_version(version)
        lines = [*kept.lost, *write_package(path, Contents(units, scene.stop, options.step, version, kept))]
    events = [f"event at t = {e.t:g} s, {e.name} = {e.value:g}: SSP has no events" for e in scene.events]
    return path, [*lines, *events]


def _outward(net: Network, names: Sequence[str]) -> dict[str, list[str]]:
    """Member -> its outward ports."""
    known = [f"{m}.{p.name}" for m, d in net.members.items() for p in d.ports if p.external]
    for name in names:
        if name not in known:
            raise SSPError(f"{net.name} has no port '{name}' that could count outward; {meant(name, known)}")
    return {m: [n.partition(".")[2] for n in names if n.partition(".")[0] == m] for m in net.members}


def _turned(net: Network, names: Sequence[str]) -> list[str]:
    """The outward ports, and one of each pair whose flows would both count the same way: terminals have no factor."""
    turned = list(names)
    for j in net.junctions:
        if not joins_plainly([net.port_of(e).given for e in j.ends]):
            continue
        inward = [_inward(net, e, turned) for e in j.ends]
        free = [str(e) for e in j.ends if isinstance(net.members[e.member], PHDAE)]
        if inward[0] == inward[1] and j.shared == net.port_of(j.ends[0]).domain.common and free:
            end = free[-1]
            turned = [n for n in turned if n != end] if end in turned else [*turned, end]
    return turned


def _inward(net: Network, end: End, outward: Sequence[str]) -> bool:
    """True if a port counts its flow into its unit."""
    member = net.members[end.member]
    if isinstance(member, PHDAE):
        return str(end) not in outward
    return next(p.sign for p in member.port_maps if p.name == end.port) > 0


def _unit(net: Network, name: str, folder: Path, options: PackageOptions, outward: list[str]) -> UnitFile:
    """A member as a unit; observables that others read are outputs of it."""
    member = net.members[name]
    if not isinstance(member, PHDAE):
        if outward:
            raise SSPError(f"{name} is a unit already; which way its ports count is fixed in it")
        return member
    heard = {w.output.partition("[")[0] for w in net.wires if w.source == name}
    told = tuple(replace(o, signal=o.signal or o.name in heard) for o in member.observables)
    model = build_model(replace(member, name=name, observables=told), options.schemes.get(name))
    (path,) = export(
        model, folder / name, (options.fmi,), step=options.step, platforms=options.platforms, outward=outward
    )
    return unit_file(path)
