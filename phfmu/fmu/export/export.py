"""Export of a model as Functional Mock-up Units."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from pathlib import Path

from phfmu.declare.entries.model_name import unwritable
from phfmu.discretise.model import Model, takes_model
from phfmu.engine.build.compile import compile, host_target, suffix
from phfmu.fmu.export import manifest, package, sources
from phfmu.fmu.export.description import ExportedUnit, build_description
from phfmu.fmu.export.schedule import UnitEvent, in_order
from phfmu.fmu.export.terminals import terminals as terminals_of
from phfmu.fmu.export.unit_modes import unit_modes
from phfmu.fmu.export.value_groups import telling_constant
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.version import VERSIONS, Version
from phfmu.words import meant

#: platform -> compiler target
PLATFORMS = {
    "x86_64-linux": "x86_64-linux-gnu.2.17",
    "aarch64-linux": "aarch64-linux-gnu.2.17",
    "x86_64-windows": "x86_64-windows-gnu",
    "x86_64-darwin": "x86_64-macos",
    "aarch64-darwin": "aarch64-macos",
}
FLAGS = ("-DPH_API=",)


@takes_model
def export(
    model: Model,
    directory: str | Path,
    versions: Sequence[str | Version] = tuple(VERSIONS),
    *,
    step: float,
    stop: float | None = None,
    platforms: Sequence[str] | None = None,
    node_inputs: bool = False,
    ledger_outputs: bool = True,
    terminals: bool = True,
    left_out: Sequence[str] = (),
    arrays: bool = False,
    outward: Sequence[str] = (),
    tunable: Collection[str] = (),
    impulses: bool = False,
    events: Sequence[UnitEvent] = (),
) -> list[Path]:
    """Write `<name>_fmi2.fmu` and `<name>_fmi3.fmu` into `directory`; the paths in the order of `versions` (numbers, or rows as
    in `phfmu.fmu.version`).

    `model`: of `build_model`, it carries its declaration.  `step`: longest internal and suggested communication step, s.
    `platforms`: keys of PLATFORMS, default this machine.  `node_inputs`: optional port inputs at the nodes of a step,
    and the outputs there (order 4, 6), with impulses at its ends for ports that take some; `impulses`: the same at order 2
    too, FMUError if no port does.  `ledger_outputs`: energies and residuals of constraints as outputs, else as
    local variables.  `terminals`: a file that lists the ports as terminals.  `left_out`: lines about what the unit
    has not, for its documentation and manifest.  `arrays`: vector ports as array variables in FMI 3.0.
    `outward`: ports whose flow (the current, the force: what sums to zero at a connection) counts out of the unit, for tools
    that connect variables plainly.
    `tunable`: parameters that may be set between steps, by scalar or vector name; what that makes of stored energy is booked
    (`energy.events`).  `events`: values that parameters take at given times inside the unit (`schedule.py`).
    The same model gives the same bytes.  Errors: TypeError for anything but a model; FMUError, CompilerMissing, CompileError.
    """
    rows = rows_of(versions)
    _require_writable(model, step, tunable, node_inputs or impulses)
    model = telling_constant(model)
    set_later, inside = _scalars(model, [*tunable, *(e.name for e in events)]), in_order(model, events)
    unit = ExportedUnit(
        model, step, stop, node_inputs, ledger_outputs, terminals, tuple(left_out), arrays, tuple(outward), set_later, impulses,
        inside,
    )  # fmt: skip
    return written(unit, directory, rows, platforms)


def written(
    unit: ExportedUnit, directory: str | Path, rows: Sequence[Version], platforms: Sequence[str] | None
) -> list[Path]:
    """The archives of a unit, one a version; CompilerMissing, CompileError."""
    equations = sources.generated(unit)
    token = sources.token(unit, equations)
    code = sources.complete(unit, equations, token)
    asked = [host_platform()] if platforms is None else platforms
    libraries, beside = _libraries(code, asked), unit.resources(asked)
    paths = []
    for version in rows:
        path = Path(directory) / f"{unit.identifier}_{version.prefix}.fmu"
        inside = {f"resources/{n}": data for n, data in beside.items()}
        package.write(path, _files(unit, version, token, code, libraries) | inside)
        paths.append(path)
    return paths


def _require_writable(model: Model, step: float, tunable: Collection[str], exchanged: bool) -> None:
    """FMUError for what no unit can be; `exchanged`: values at the nodes of a step, or impulses."""
    if bad := unwritable(model.declaration):
        raise FMUError("; ".join(str(p) for p in bad))
    if not (math.isfinite(step) and step > 0):
        raise FMUError(f"{model.name}: step = {step} s must be positive")
    if model.loses_energy:
        raise FMUError(
            f"{model.name}: scheme {model.scheme.name} loses energy of its own, for which an FMU has no variable; "
            "export an energy-exact scheme, and restart with Radau steps in `phfmu run --restart`"
        )
    if model.modes is not None and (bound := model.modes.modes.system.between_inputs):
        raise FMUError(
            f"{model.name}: has ideal switches ({', '.join(bound[:4])}) between inputs, which others set, so that none of its "
            "modes could be left; export it together with what is on one side of them"
        )
    unit_modes(model)
    if model.events is not None and exchanged:
        raise FMUError(
            f"{model.name}: has state events ({', '.join(model.events.names[:4])}), which do not go with inputs at the nodes of "
            "a step in a unit; export it without --node-inputs and --impulses"
        )
    if set_inside := sorted(_scalars(model, tunable) & {*model.declaration.modes}):
        raise FMUError(f"{model.name}: state events set {set_inside[0]}, which cannot be tunable as well")


def _scalars(model: Model, tunable: Collection[str]) -> frozenset[str]:
    """Scalar names of parameters; FMUError names what is none."""
    known = {n: [n] for v in model.declaration.parameters for n in v.names()}
    known |= {v.name: v.names() for v in model.declaration.parameters}
    if lost := [n for n in tunable if n not in known]:
        raise FMUError(f"{model.name} has no parameter '{lost[0]}' to be tunable; {meant(lost[0], known)}")
    return frozenset(n for name in tunable for n in known[name])


def rows_of(versions: Sequence[str | Version]) -> list[Version]:
    """The versions of the standard by their numbers; FMUError."""
    known = [v if isinstance(v, Version) else VERSIONS.get(v) for v in versions]
    rows = [v for v in known if v is not None]
    if not rows or len(rows) < len(known):
        raise FMUError(f"FMI versions {list(versions)}; known: {', '.join(VERSIONS)}")
    return rows


def host_platform() -> str:
    """The key of PLATFORMS of this machine."""
    target = host_target()
    for name, known in PLATFORMS.items():
        if known == target:
            return name
    raise FMUError(f"there is no FMI platform name for {target}; known: {', '.join(PLATFORMS)}")


def _libraries(code: sources.Sources, platforms: Sequence[str]) -> dict[str, bytes]:
    """Platform -> the library with all versions of the interface."""
    unknown = [p for p in platforms if p not in PLATFORMS]
    if unknown:
        raise FMUError(f"unknown platform {', '.join(unknown)}; known: {', '.join(PLATFORMS)}")
    everything = {**code, **sources.headers()}
    return {p: compile(everything, PLATFORMS[p], flags=FLAGS).path.read_bytes() for p in platforms}


def _files(
    unit: ExportedUnit, version: Version, token: str, code: sources.Sources, libraries: dict[str, bytes]
) -> dict[str, bytes]:
    """Content of the archive of one version."""
    own = sources.of_version(code, version, unit.identifier)
    files = {f"sources/{n}": s.read_bytes() if isinstance(s, Path) else s.encode() for n, s in own.items()}
    compiled = sorted(n for n in own if n.endswith(".c"))
    files["sources/buildDescription.xml"] = build_description(unit, compiled)
    files["modelDescription.xml"] = version.description(unit, token, compiled)
    for platform, library in libraries.items():
        folder = version.folders_of(platform)[0]
        files[f"binaries/{folder}/{unit.identifier}{suffix(PLATFORMS[platform])}"] = library
    ports = terminals_of(unit, version)
    if ports:
        files["terminalsAndIcons/terminalsAndIcons.xml"] = ports
    return files | {manifest.PATH: manifest.manifest(unit)} | package.documentation(unit)
