"""Units of other tools inside the unit of a coupled network: what can be there, what is told of it, its table in C, its files.

Its library, resources and licences stand among the resources of the unit, in a folder that is called as the member; C loads it
from there (`runtime/embedded.h`).
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np

from phfmu.engine.build.compile import suffix
from phfmu.engine.build.tables import array_text
from phfmu.fmu.export.export import PLATFORMS
from phfmu.fmu.export.variables import FMUError, writable_name
from phfmu.fmu.importer.archive import Archive, open_archive
from phfmu.fmu.importer.reader import FMUInstance
from phfmu.fmu.importer.unit_file import UnitFile
from phfmu.fmu.importer.unit_interface import Scalar
from phfmu.fmu.importer.values import References
from phfmu.fmu.version import VERSIONS, Version
from phfmu.fmu.words import c_string
from phfmu.fmu.xml import number
from phfmu.network.members.fmu_member import FMUMember
from phfmu.network.network import Network
from phfmu.network.wires import Wire
from phfmu.signals import Causality, Quantity, port_energy, total

#: what is told of the energy of one: name after `energy.`, block, meaning
_ENERGIES = (
    ("stored", "H", "energy supplied since the start, which counts as stored: what it dissipates it keeps to itself"),
    ("supplied", "supplied", "energy supplied through ports since the start, estimated"),
    ("supplied_step", "row_supplied", "energy supplied through ports in the last step, estimated"),
)

#: types of values -> in C, and their `ph_type`
_IN_C: dict[Any, tuple[str, str]] = {
    getattr(ctypes, f"c_{u}int{b}"): (f"{u}int{b}_t", f"PH_{u.upper()}INT{b}") for u in ("", "u") for b in (8, 16, 32, 64)
} | {
    ctypes.c_int: ("int", "PH_INT32"), ctypes.c_bool: ("bool", "PH_BOOLEAN"), ctypes.c_float: ("float", "PH_FLOAT32"),
}  # fmt: skip


def require_embeddable(network: Network, platforms: Sequence[str]) -> None:
    """FMUError for units that cannot be inside another one."""
    problems = [
        f"{name}: {problem}"
        for name, f in network.units.items()
        if (problem := _problem(f, open_archive(f.path), platforms) or _of_signals(name, f, network.wires))
    ]
    if problems:
        raise FMUError(f"{network.name}: " + "; ".join(problems))


def _problem(file: UnitFile, archive: Archive, platforms: Sequence[str]) -> str:
    about = file.interface
    if about.energy:
        return "is a unit of this package, whose declaration goes in as code: put that in its place"
    if about.tool:
        return "needs a tool of its maker where it runs (needsExecutionTool); --ssp writes a package of all members"
    if about.one_instance:
        return (
            "can have one instance in a process (canBeInstantiatedOnlyOncePerProcess), so that the whole could be there once; "
            "--ssp writes a package of all members"
        )
    if missing := [p for p in platforms if not library_of(archive, p)]:
        there = [p for p in PLATFORMS if library_of(archive, p)]
        return f"has no library for {', '.join(missing)}; it has some for {', '.join(there) or 'none'}: leave the others out"
    if bad := [n for n in file.starts if about.variables[n].size]:
        return f"the start of {bad[0]} is given, an entry of an array: set it in the unit"
    if bad := [n for p in file.port_maps for n in (*p.inputs, *p.outputs) if about.variables[n].type != "Float64"]:
        return (
            f"the variable {bad[0]} of a port is of the type {about.variables[bad[0]].type}; ports are of type Float64"
        )
    return ""


def _of_signals(name: str, file: UnitFile, wires: Sequence[Wire]) -> str:
    own = [w.output for w in wires if w.source == name] + [w.input for w in wires if w.target == name]
    known = file.interface.variables
    bad = [n for n in own if n not in known or known[n].size or known[n].type != "Float64"]
    return f"the signal {bad[0]} is no scalar of type Float64" if bad else ""


def library_of(archive: Archive, platform: str) -> str | None:
    """Name in the archive of the library for a key of PLATFORMS."""
    return archive.library_for(platform, suffix(PLATFORMS[platform]))


def untold(file: UnitFile) -> list[str]:
    """Lines about what the whole does not tell of a unit inside."""
    about = file.interface.variables
    kinds = [n for n, v in about.items() if v.type != "Float64" and v.size and v.causality in ("output", "local")]
    names = [n for n, v in about.items() if v.type == "Float64" and not writable_name(n)]
    lines = [f"{', '.join(kinds[:4])}{_more(kinds)}: arrays of another type than Float64"] if kinds else []
    return [*lines, *([f"{', '.join(names[:4])}{_more(names)}: no structured name"] if names else [])]


def _more(names: Sequence[str]) -> str:
    return f" and {len(names) - 4} more" if len(names) > 4 else ""


@dataclass(frozen=True, eq=False)
class EmbeddedUnit:
    """A unit of another tool as a member: what the run steps, and its file.

    `step`, `instant`: lengths of its blocks, as those of a model.
    """

    member: FMUMember
    file: UnitFile

    @property
    def name(self) -> str:
        return self.member.name

    @property
    def unit(self) -> FMUInstance:
        return self.member.unit

    @cached_property
    def told(self) -> list[Scalar]:
        """Output and local variables that the unit tells beside the values of its ports; Float64 first."""
        scalars = [self.unit.variable(n) for n in self.member.names]
        told = [v for v in scalars if (v.type == "Float64" or not v.size) and writable_name(v.name)]
        return [*(v for v in told if v.type == "Float64"), *(v for v in told if v.type != "Float64")]

    @cached_property
    def settable(self) -> list[Scalar]:
        """Variables that may be set: parameters, inputs without power, then others with a start value that was given."""
        variables = self.file.interface.variables
        parameters = [v for v in variables.values() if v.causality == "parameter" and v.start is not None]
        known = [*parameters, *(variables[n] for n in self.unit.other_inputs)]
        known = [v for v in known if v.type == "Float64" and not v.size and writable_name(v.name)]
        names = {v.name for v in known}
        return [*known, *(v for n in self.file.starts if n not in names and (v := variables[n]).type == "Float64")]

    @cached_property
    def typed(self) -> list[Scalar]:
        """Variables of other types than Float64 whose start was given."""
        variables = self.file.interface.variables
        return [v for n in self.file.starts if (v := variables[n]).type != "Float64"]

    @cached_property
    def step(self) -> Any:
        nu = self.unit.nu
        return SimpleNamespace(nx=0, na=0, nu=nu, nq=nu, np=len(self.settable), ncomp=1, nobs=len(self.told))

    @property
    def instant(self) -> Any:
        return self.step

    # -- variables ----------------------------------------------------------------------------------------------------

    def quantities(self, joined: frozenset[str]) -> Iterator[Quantity]:
        """Its own names, as `signals.quantities` has those of a model; `joined`: ports that junctions feed."""
        inner = {n for p in self.unit.ports if p.name in joined for n in p.outputs}
        for i, v in enumerate(self.settable):
            if v.causality in ("parameter", "input") and v.name not in self.unit.inputs:
                yield self._settable(i, v)
        yield from self._inputs(joined)
        for i, v in enumerate(self.told):
            causality: Causality = "output" if v.causality == "output" and v.name not in inner else "local"
            yield self._quantity(v, causality, "observables", i)
        names, first = {*self.file.interface.variables}, 0
        for p in self.unit.ports:
            n, text = len(p.inputs), f"energy of port {p.name}, supplied since the start, estimated"
            if port_energy(p.name) not in names:
                yield Quantity(port_energy(p.name), "local", "energy", first, n, None, "J", description=text)
            first += n
        for name, block, text in _ENERGIES:
            if total(name) not in names:
                yield Quantity(total(name), "local", block, 0, 1, None, "J", description=text)

    def _settable(self, i: int, v: Scalar) -> Quantity:
        late = v.causality == "input" or v.variability == "tunable"
        causality: Causality = "input" if v.causality == "input" else "parameter"
        return self._quantity(v, causality, "tunable" if late else "parameter", i, self._start(v))

    def _inputs(self, joined: frozenset[str]) -> Iterator[Quantity]:
        """Inputs of ports that count in the units of the domain: of others that are joined nothing is told."""
        first, begin = 0, self.unit.start_inputs()
        for p in self.unit.ports:
            for i, name in enumerate(p.inputs, first):
                v = self.unit.variable(name)
                if abs(self.unit.input_sign[i]) == 1.0 and writable_name(name):
                    yield self._quantity(v, "input", "input", i, float(begin[i] / self.unit.input_sign[i]) + 0.0)
                elif p.name not in joined:
                    raise FMUError(
                        f"{self.name}.{p.name}: the variable '{name}' of this free port counts in other units than its domain; "
                        "join the port"
                    )
            first += len(p.inputs)

    def outward(self) -> list[str]:
        """Inputs of ports that count out of the unit, as it has them."""
        return [n for n, sign in zip(self.unit.inputs, self.unit.input_sign.tolist(), strict=True) if sign == -1.0]

    @staticmethod
    def _quantity(v: Scalar, causality: Causality, block: str, i: int, start: float | None = None) -> Quantity:
        return Quantity(v.name, causality, block, i, 1, start, v.unit, None, v.description)

    def _start(self, v: Scalar) -> float:
        return float(self.file.starts.get(v.name, v.start or 0.0))

    # -- C ------------------------------------------------------------------------------------------------------------

    def text(self, symbol: str, sent: Sequence[str], taken: Sequence[str]) -> str:
        """Its `ph_embedded`, called `symbol`, and all it points to; `sent`, `taken`: held signals that it exchanges."""
        values, about = self.unit._values, self.file.interface
        version, nu = VERSIONS[about.version], values.nu
        texts = list[str]()

        def scalars(name: str, found: Sequence[Scalar], sign: Any) -> str:
            text, initialiser = _scalars(f"{symbol}_{name}", found, sign, version)
            texts.append(text)
            return initialiser

        outputs = [*values.y_end.scalars, *(about.variables[n] for n in values.displacements)]
        rate = np.full(nu, -1, np.int32)
        rate[values.rates] = nu + np.arange(len(values.rates))
        groups = {
            "input": scalars("input", values.u.scalars, values.input_sign),
            "looked": scalars("looked", outputs, np.append(values.output_sign, values.displacement_sign)),
            "told": scalars("told", (own := [v for v in self.told if v.type == "Float64"]), np.ones(len(own))),
            "sent": scalars("sent", [about.variables[n] for n in sent], np.ones(len(sent))),
        }
        settable = [scalars(f"set{i}", [v], np.ones(1)) for i, v in enumerate(self.settable)]
        texts.append(f"static const ph_scalars {symbol}_settable[] = {{{', '.join(settable) or '{0}'}}};\n")
        texts.append(self._typed_text(f"{symbol}_typed", version))
        others = [(version.types[v.type], v.reference) for v in self.told if v.type != "Float64"]
        rows = ", ".join(f'{{"Get{word}", {_IN_C[element][1]}, {r}u, 0}}' for (word, element), r in others)
        texts.append(f"static const ph_typed {symbol}_other[] = {{{rows or '{0}'}}};\n")
        late = [v.causality == "input" or v.variability == "tunable" for v in self.settable]
        watched = [i for i, v in enumerate(self.told) if v.causality == "output"]
        place = {v.name: i for i, v in enumerate(self.settable)}
        arrays = {
            "start": ("double", np.array([self._start(v) for v in self.settable])),
            "given": ("int", np.array([v.name in self.file.starts for v in self.settable], np.int32)),
            "late": ("int", np.array(late, np.int32)), "begin": ("double", self.unit.start_inputs()),
            "rate": ("int", rate), "watched": ("int", np.array(watched, np.int32)),
            "taken": ("int", np.array([place[n] for n in taken], np.int32)),
        }  # fmt: skip
        texts += [array_text(kind, f"{symbol}_{n}", a) for n, (kind, a) in arrays.items() if len(a)]
        numbers = {
            "saves": int(about.saves), "serialises": int(about.saves and about.serialises),
            "no_set_prior": int(self.unit.steps.no_set_prior is not False),
            "in_parts": int(self.unit.steps.in_parts),
            "tolerance_told": int(self.file.tolerance is not None), "tolerance": number(self.file.tolerance or 0.0),
            "nu": nu, "np": len(self.settable), "ntyped": len(self.typed), "nother": len(self.told) - len(own),
            "nlooked": len(outputs), "nwatched": len(watched), "ntaken": len(taken),
        }  # fmt: skip
        members = {
            "member": c_string(self.name),
            "identifier": c_string(about.identifier),
            "token": c_string(about.token),
        }
        members |= {"standard": f"ph_standard_{version.prefix}"} | numbers | groups
        members |= {"settable": f"{symbol}_settable", "typed": f"{symbol}_typed", "other": f"{symbol}_other"} | {
            n: f"{symbol}_{n}" for n, (_, a) in arrays.items() if len(a)
        }
        rows = "".join(f"    .{n} = {text},\n" for n, text in members.items())
        finish = "ph_embedded_finish" if self.member.finishes else "0"
        table = (
            f"static const ph_embedded_about {symbol}_about = {{\n{rows}    .library = {{{self._libraries()}}},\n}};\n"
        )
        places = f"{symbol}_taken" if taken else "0"
        map_and_kind = f"&{symbol}_about, ph_map_embedded, ph_kind_embedded, {finish}, {places}"
        return f"{''.join(texts)}{table}static const ph_embedded {symbol} = {{{map_and_kind}}};\n"

    def _typed_text(self, name: str, version: Version) -> str:
        """Starts of other types, as the functions of the version take them."""
        texts, rows = list[str](), list[str]()
        for i, v in enumerate(self.typed):
            word, element = version.types[v.type]
            found = References([v], version)
            found.values[:] = self.file.starts[v.name]
            found.spread(found.by_type[0])
            (value,) = found.by_type[0].buffer.tolist()
            written = f"{value!r}f" if element is ctypes.c_float else str(int(value))
            texts.append(f"static const {_IN_C[element][0]} {name}{i} = {written};\n")
            rows.append(f'{{"Set{word}", {_IN_C[element][1]}, {v.reference}u, &{name}{i}}}')
        return f"{''.join(texts)}static const ph_typed {name}[] = {{{', '.join(rows) or '{0}'}}};\n"

    def _libraries(self) -> str:
        archive = open_archive(self.file.path)
        found = [library_of(archive, p) for p in PLATFORMS]
        return ", ".join("0" if n is None else c_string(n) for n in found)

    # -- files --------------------------------------------------------------------------------------------------------

    def files(self, platforms: Sequence[str]) -> dict[str, bytes]:
        """Its files below resources/, without the libraries of other platforms."""
        archive = open_archive(self.file.path)
        folders = {name.rpartition("/")[0] for p in platforms if (name := library_of(archive, p))}
        return {f"{self.name}/{n}": data for n, data in archive.contents(folders).items()}


def _scalars(name: str, scalars: Sequence[Scalar], sign: Any, version: Version) -> tuple[str, str]:
    """Arrays of a `ph_scalars`, and what initialises it."""
    r = References(scalars, version)
    if not r.n:
        return "", "{0}"
    of = r.by_type[0]
    references = ", ".join(f"{v}u" for v in of.references)
    text = f"static const unsigned {name}_reference[] = {{{references}}};\n"
    text += array_text("int", f"{name}_place", of.picks.astype(np.int32))
    text += array_text("int", f"{name}_at", np.arange(r.n, dtype=np.int32))
    text += array_text("double", f"{name}_sign", np.asarray(sign, float))
    fields: Mapping[str, Any] = {
        "reference": f"{name}_reference", "nreference": of.n, "nvalue": of.total, "n": r.n, "place": f"{name}_place",
        "at": f"{name}_at", "sign": f"{name}_sign",
    }  # fmt: skip
    return text, "{" + ", ".join(f".{n} = {v}" for n, v in fields.items()) + "}"
