"""Inspection of an FMU and of what is wrong with it, without running it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import fmpy

from phfmu.fmu.export.manifest import PortMap
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.archive import Archive, open_archive
from phfmu.fmu.importer.ports.port_tables import ENDING, domain_of, unit_of
from phfmu.fmu.importer.unit_file import UnitFile, unit_file
from phfmu.fmu.importer.unit_interface import Scalar, UnitInterface
from phfmu.words import counted

#: pairs of variables that are told
PAIRS = 4
#: kinds of variables in the order they are told
_TITLES = {
    "parameter": "parameters",
    "structuralParameter": "structural parameters, which stay as they are here",
    "calculatedParameter": "parameters that follow from others",
    "input": "inputs",
    "output": "outputs",
    "local": "local variables",
}


def fmu_info(path: str | Path) -> str:
    """Text: version, ports with their pairs, variables with units and starts.  FMUError if it cannot be read."""
    archive, file = open_archive(path), unit_file(path)
    face = archive.interface
    lines = [f"{face.name}: {face.description}".rstrip(": "), f"FMI {face.version} for Co-Simulation"]
    lines.append(f"libraries for: {', '.join(archive.platforms) or 'no platform'}{_here(archive)}")
    abilities = {
        "saves and restores its state": face.saves,
        "gives directional derivatives": face.derivatives,
    }
    lines += [f"{text}: {'yes' if able else 'no'}" for text, able in abilities.items()]
    lines += limit_lines(face)
    lines.append(f"energy ledger: {'exact, in the unit' if face.energy else 'none; port work can be estimated'}")
    if face.step is not None:
        lines.append(f"suggested step {face.step:g} s" + (f", stop {face.stop:g} s" if face.stop is not None else ""))
    lines += port_lines(file.port_maps) or _ports_wanted(file)
    for causality, title in _TITLES.items():
        chosen = [v for v in face.variables.values() if v.causality == causality]
        if chosen:
            lines.append(f"{title}:")
        for v in chosen:
            start = "" if v.start is None else f"{v.start:g}"
            lines.append(f"  {v.name:<32} {_kind(v):<12} {start:<16} {v.description}".rstrip())
    lines += file.left_out
    return "\n".join(lines) + "\n"


def limit_lines(face: UnitInterface) -> list[str]:
    """Demands of the unit on an importer, as far as they are not usual."""
    clocks = f"has {counted(face.clocks, 'clock')}, which {'ticks' if face.clocks == 1 else 'tick'} in Event Mode only"
    return [
        text
        for text, so in (
            ("takes steps of one length only", face.one_step),
            ("can be instantiated once per process only", face.one_instance),
            ("needs a tool of its maker", face.tool),
            (f"{clocks}: run here, what depends on them stays as it is", face.clocks),
            ("has an Event Mode, which is not entered here: its events happen within its steps", face.event_mode),
            ("may return early from doStep, which it is not allowed here", face.early_return and not face.energy),
        )
        if so
    ]


def _kind(v: Scalar) -> str:
    """Its unit, and its type where that is not Float64."""
    told = [v.unit] if v.type == "Float64" or v.unit != "1" else []
    return ", ".join([*told, *([v.type] if v.type != "Float64" else [])])


def port_lines(ports: Sequence[PortMap]) -> list[str]:
    """The ports with their pairs."""
    lines = ["ports (power positive into the component):"] if ports else []
    for p in ports:
        sense = f"; {p.domain.word(p.domain.summed)} positive out of the component" if p.sign < 0 else ""
        pairs = f"input {', '.join(p.inputs)}; output {', '.join(p.outputs)}"
        work = "" if p.step_outputs else f"; work by {', '.join(p.displacements) or 'the trapezoidal rule'}"
        lines.append(f"  {p.name:<24} {p.domain.name:<14} {pairs}{sense}{work}")
    return lines


def _ports_wanted(file: UnitFile) -> list[str]:
    """Advice on declaring ports, with the pairs of variables whose units make a power; empty without inputs and outputs."""
    face = file.interface
    given, told = ([v.name for v in face.variables.values() if v.causality == c] for c in ("input", "output"))
    if not given or not told:
        return []
    pairs = []
    for u in given:
        for y in told:
            units = unit_of(face, u), unit_of(face, y)
            domain = domain_of(*units) or domain_of(*units[::-1])
            if domain is not None:
                pairs.append(f"{u} and {y} ({domain.name})")
    more = f", {len(pairs) - PAIRS} more" if len(pairs) > PAIRS else ""
    guess = f"; by their units these could be: {', '.join(pairs[:PAIRS])}{more}" if pairs else ""
    beside = file.path.with_suffix("").name + ENDING
    return [f"ports: none told; to join it, name pairs of variables in {beside}: [PORT], effort, flow, sign{guess}"]


def _here(archive: Archive) -> str:
    """Lines to know before it is run on this machine."""
    try:
        return f" (here: {archive.library})"
    except FMUError:
        return f" (none for this machine, {fmpy.platform_tuple}: it can be read, not run)"


def fmu_problems(path: str | Path) -> list[str]:
    """Problems of the archive, its XML and its binaries, found by this package and by FMPy's validation."""
    try:
        _ = open_archive(path).library
    except FMUError as error:
        return [str(error)]
    from fmpy.validation import validate_fmu

    return [str(problem) for problem in validate_fmu(str(path))]
