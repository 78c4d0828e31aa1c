"""C sources of a unit: the runtime, the protocol layers, and what is generated for the model."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Sequence
from math import isfinite
from pathlib import Path

import fmpy

from phfmu.discretise.model import CONSISTENCY, Model
from phfmu.engine.build.codegen import kernel_table, port_text, slope_text, tangent_text
from phfmu.engine.build.runtime_sources import runtime_sources
from phfmu.engine.build.tables import c_text, events_text
from phfmu.engine.impulses import PortKernels
from phfmu.engine.model import kernels
from phfmu.fmu.export.description import ExportedUnit
from phfmu.fmu.export.unit_modes import ROWS, SWITCHES, UnitModes, events_symbol, model_symbol, symbols, unit_modes
from phfmu.fmu.export.variables import value_name
from phfmu.fmu.version import VERSIONS, Version
from phfmu.fmu.words import c_comment, c_string
from phfmu.fmu.xml import number

RUNTIME = Path(__file__).parent.parent / "runtime"

#: headers of the standard; importers that compile sources bring their own
HEADERS = Path(str(fmpy.__file__)).parent / "c-code"

_PREFIXES = tuple(v.prefix for v in VERSIONS.values())

#: files of units with inputs at the nodes of a step, of those whose ports take impulses, and with switches
NODES, IMPULSES, MODES = ("fmu_nodes.c",), ("impulses.c", "impulses.h"), ("fmu_modes.c", "fmu_mode_refused.c")
#: of units with derivatives by states and parameters
ALONG = ("fmu_along.c",)
#: with state events, and of one model
HAPPENED, LANDING = ("fmu_happened.c",), ("fmu_landing.c",)
Sources = dict[str, str | Path]


def generated(unit: ExportedUnit) -> dict[str, str]:
    """kernels.c and model.c, tangents.c where there are inputs, slopes.c with derivatives by parameters, ports.c with impulses,
    guards.c with state events: nothing of the interface.
    """
    if texts := unit.texts():
        return texts
    model = unit.model
    modes = unit_modes(model)
    table = kernel_table([*kernels(model), *(modes.kernels if modes else ())], model.step.schur)
    more = {} if model.events is None else {"guards.c": events_text(model.events, table.index)}
    more |= modes.texts(table, "ph_tangents" if model.step.nu else "0") if modes else {}
    if model.step.nu == 0:
        return {"kernels.c": table.text, "model.c": c_text(model, table.index), **more}
    far = unit.derives_by_states
    text = c_text(model, table.index, tangents="ph_tangents", slopes="ph_slopes" if far else "0")
    plans = (model.step, model.instant) if far or unit.kernels else (model.step, *(modes.plans if modes else ()))
    made = {"kernels.c": table.text, "tangents.c": tangent_text(table, *plans, reports=far), "model.c": text, **more}
    made |= {"slopes.c": slope_text(table, *plans)} if far else {}
    return made | ({"ports.c": port_text(unit.kernels)} if unit.kernels else {})


def token(unit: ExportedUnit, equations: dict[str, str]) -> str:
    """Fingerprint of equations, runtime and all descriptions, in the form of a GUID."""
    digest = hashlib.sha256()
    for name, source in sorted({**fixed(unit), **equations}.items()):
        content = source.read_bytes() if isinstance(source, Path) else source.encode()
        digest.update(f"{name} {len(content)}\n".encode() + content)
    digest.update(b"".join(version.description(unit) for version in VERSIONS.values()))
    h = digest.hexdigest()
    return f"{{{h[:8]}-{h[8:12]}-{h[12:16]}-{h[16:20]}-{h[20:32]}}}"


def fixed(unit: ExportedUnit) -> Sources:
    """The hand-written part of it: name -> path."""
    if drivers := unit.drivers():
        absent = (*NODES, *LANDING, *MODES[:1], *ALONG, *(() if unit.lands else HAPPENED))
        absent += () if unit.changes_modes else MODES
        layers = {n: p for n, p in _layers().items() if n not in absent}
        return {**runtime_sources(*_parts(unit)), **drivers, **layers}
    events, modes = unit.lands, unit.changes_modes
    parts = _parts(unit)
    absent = (() if unit.at_nodes else NODES) + (() if unit.kernels else IMPULSES)
    absent += () if events else (*HAPPENED, *LANDING)
    absent += () if modes else MODES
    absent += () if unit.derives_by_states else ALONG
    return {name: path for name, path in {**runtime_sources(*parts), **_layers()}.items() if name not in absent}


def _parts(unit: ExportedUnit) -> list[str]:
    """Folders of the runtime that it needs."""
    return [*(["events"] if unit.lands else []), *(["modes"] if unit.changes_modes else [])]


def _layers() -> Sources:
    return {p.name: p for p in sorted(RUNTIME.iterdir()) if p.suffix in (".c", ".h")}


def complete(unit: ExportedUnit, equations: dict[str, str], token: str) -> Sources:
    """All a library with all versions is compiled from, but the headers of the standard."""
    return {**fixed(unit), **equations, "interface.c": interface_text(unit, token)}


def of_version(sources: Sources, version: Version, identifier: str) -> Sources:
    """The sources an importer of one version can compile, with names of their own: `identifier` before each."""
    others = {name for v in VERSIONS.values() for name in v.layers}.difference(version.layers)
    own = {name: source for name, source in sources.items() if name not in others}
    return own | {"names.h": names_text(own, identifier)}


def names_text(sources: Sources, identifier: str) -> str:
    """names.h: what the headers declare for the linker, renamed."""
    found: set[str] = set()
    own = rf"\b((?:{'|'.join(('ph', 'fmu', *_PREFIXES))})_\w+)\("
    for name, source in sources.items():
        if name.endswith(".h"):
            text = source.read_text() if isinstance(source, Path) else source
            found.update(re.findall(own, text))
            found.update(re.findall(r"^extern const [^;=]*?(\w+)(?:\[\])?;", text, flags=re.M))
    tables = {
        "network.c": "ph_the_network",
        "model.c": "ph_the_model",
        "ports.c": "ph_the_ports",
        "guards.c": "ph_the_events",
    }
    found.update(symbol for file, symbol in tables.items() if file in sources)
    found.update(symbols(sources))
    for name in sources:  # of members, which share kernels and ports with those like them
        if match := re.fullmatch(r"(kernels|tangents|member|ports|guards)(\d+)\.c", name):
            found.add(f"ph_{'code' if match[1] == 'kernels' else match[1]}{match[2]}")
    lines = "".join(f"#define {name} {identifier}_{name}\n" for name in sorted(found))
    return f"/* Generated. Names of {identifier}, for programs that several units are linked into. */\n{lines}"


def headers() -> Sources:
    """Headers of the standard."""
    return {p.name: p for p in sorted(HEADERS.glob("*.h")) if p.name.startswith(_PREFIXES)}


def _list(values: Iterable[str]) -> str:
    return "".join(f"    {v},\n" for v in values)


def _strings(name: str, values: Iterable[str]) -> tuple[str, str]:
    """Definition of an array of strings and how to name it."""
    items = _list(c_string(v) for v in values)
    return (f"static const char *const {name}[] = {{\n{items}}};\n", name) if items else ("", "0")


def _c_number(value: float) -> str:
    return number(value) if isfinite(value) else "INFINITY" if value > 0 else "-INFINITY"


def interface_text(unit: ExportedUnit, token: str) -> str:
    """interface.c: variables, checks and names of the equations."""
    kind, symbol, map_of = unit.about
    variables = [f"{{{v.block}, {v.first}, {v.count}, {c_string(v.name)}, {v.sign}}}" for v in unit.variables]
    checks, ranges, events = _tables(unit)
    texts, initialisers = zip(*(_equations_text(*e, str(i)) for i, e in enumerate(unit.equations)), strict=True)
    include, nodes, tables = _optional_parts(unit)
    arrays = "".join(
        f"static const {of} {name}[] = {{\n{_list(rows)}}};\n"
        for of, name, rows in (("fmu_event", "events", events), ("fmu_range", "ranges", ranges))
        if rows
    )
    checked = f"static const fmu_check checks[] = {{\n{_list(checks)}}};\n" if checks else ""
    return f"""\
/* Generated. Variables, start checks and names of the equations of {c_comment(unit.name)}. */
#include <math.h>

#include "fmu.h"
{include}
extern const {kind} {symbol};

static const fmu_variable variables[] = {{
{_list(variables)}}};
{checked}{tables}{arrays}{"".join(texts)}static const fmu_equations equations[] = {{
{_list(f"{{{text}}}" for text in initialisers)}}};

const fmu_interface fmu_the_interface = {{
    .token = "{token}",
    .map = {map_of},
    .of = &{symbol},
    .step = {number(unit.step)},
    .nvariable = {len(variables)},
    .ncheck = {len(checks)},
    .nrange = {len(ranges)},
    .variables = variables,
    .sizes = {"sizes" if unit.spans else "0"},
    .checks = {"checks" if checks else "0"},
    .ranges = {"ranges" if ranges else "0"},
    .equations = equations,
    .jumps = {int(unit.jumps)},
    .nevent = {len(events)},
    .events = {"events" if events else "0"},
{nodes}}};
"""


def _tables(unit: ExportedUnit) -> tuple[list[str], list[str], list[str]]:
    """Rows of the start checks, of the ranges of variables and of the events of a scene."""
    place = {v.name: i for i, v in enumerate(unit.variables)}
    checks = [f"{{{place[n]}, {number(CONSISTENCY * s)}}}" for n, s in unit.checks]
    ranges = [
        f"{{{i}, {_c_number(v.limit.min)}, {_c_number(v.limit.max)}, {int(v.limit.above)}}}"
        for i, v in enumerate(unit.variables)
        if v.limit is not None
    ]
    events = [f"{{{number(e.t)}, {place[value_name(unit.model, e.name)]}, {number(e.value)}}}" for e in unit.events]
    return checks, ranges, events


def _optional_parts(unit: ExportedUnit) -> tuple[str, str, str]:
    """Headers, entries of the interface and definitions of the parts that not every unit has."""
    include = "".join(f'#include "{name}"\n' for name in unit.headers)
    nodes = "    .node_memory = fmu_node_memory,\n    .node_map = fmu_node_map,\n" if unit.at_nodes else ""
    tables = ""
    if unit.spans:
        sizes = [str(unit.spans[i].size if i in unit.spans else 1) for i in range(len(unit.variables))]
        tables = f"static const int sizes[] = {{\n{_list(sizes)}}};\n"
    if unit.derives_by_states:
        nodes += "".join(f"    .{n} = fmu_{n},\n" for n in ("along_room", "along", "asks_along"))
    if unit.kernels:
        include, nodes = include + '#include "impulses.h"\n', nodes + "    .impulses = &impulses,\n"
        tables += _impulses_text(unit.kernels)
    if unit.lands:
        include, nodes = include + '#include "events.h"\n', nodes + "    .landing = &landing,\n"
        include += '#include "fmu_modes.h"\n#include "modes.h"\n' if unit.model.modes else ""
        tables += unit.landing or _landing_text(unit.model)
    return include, nodes, tables


def _equations_text(part: str, steps: Sequence[str], instants: Sequence[str], suffix: str) -> tuple[str, str]:
    """The names of equations, and what initialises their fmu_equations; `suffix`: of the names of these in C."""
    named = [_strings(f"{what}{suffix}", names) for what, names in (("step_rows", steps), ("end_rows", instants))]
    sizes = f"{len(steps)}, {len(instants)}"
    return "".join(t for t, _ in named), f"{c_string(part)}, {sizes}, {', '.join(name for _, name in named)}"


def _landing_text(model: Model) -> str:
    """The functions of fmu_landing.c or fmu_modes.c, and the names of the guards."""
    assert model.events is not None
    names, guards = _strings("guards", model.events.names)
    modes = unit_modes(model)
    layer, switches = ("modes", "&switches") if modes else ("landing", "0")
    members = "".join(f"    .{n} = fmu_{layer}_{n},\n" for n in ("create", "release", "step", "refused"))
    return (
        f"extern const ph_events ph_the_events;\n{names}{_modes_text(modes) if modes else ''}"
        f"static const fmu_landing landing = {{\n    .events = &ph_the_events,\n    .names = {guards},\n"
        f"{members}    .switches = {switches},\n}};\n"
    )


def _modes_text(modes: UnitModes) -> str:
    """The modes with their tables, and the functions of fmu_modes.c."""
    text, rows = "", []
    for i, model in enumerate(modes.models):
        names, rows_of = _equations_text("", model.row_names, model.instant_names, f"_mode{i}")
        text += f"extern const ph_model {model_symbol(i)};\nextern const ph_events {events_symbol(i)};\n"
        text += names
        rows.append(f"{{&{model_symbol(i)}, &{events_symbol(i)}, {{{rows_of}}}}}")
    functions = ("state_size", "save", "load", "fault", "reset", "asked", "ask")
    return (
        f"extern const ph_switches {SWITCHES};\nextern const ph_mode_rows {ROWS}[];\n{text}"
        f"static const fmu_mode modes[] = {{\n{_list(rows)}}};\n{_strings('switch_names', modes.names)[0]}"
        f"static const fmu_switches switches = {{\n    .switches = &{SWITCHES},\n    .n = {len(modes.models)},\n"
        f"    .rows = {ROWS},\n    .modes = modes,\n    .names = switch_names,\n"
        + "".join(f"    .{n} = fmu_modes_{n},\n" for n in functions)
        + "};\n"
    )


def _impulses_text(kernels: PortKernels) -> str:
    """The functions of impulses.c."""
    functions = {n: f"ph_impulses_{n}" for n in ("size", "init", "along")} | {
        "by": "ph_impulses_by", "jump_along": "ph_jump_along",
        "set": "ph_set_impulses", "values": "ph_impulse_values", "step": "ph_step_impulses", "kick": "ph_kick", "jump": "ph_jump",
    }  # fmt: skip
    members = "".join(f"    .{n} = {f},\n" for n, f in functions.items())
    return (
        "extern const ph_ports ph_the_ports;\n"
        f"static const fmu_impulses impulses = {{\n    .n = {kernels.n},\n    .ports = &ph_the_ports,\n{members}}};\n"
    )
