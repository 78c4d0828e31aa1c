"""Plan -> tables of the C runtime, as ctypes structures or as C text.

The field lists are those of `runtime/plan.h`; a field a_b is the plan's attribute a_b, or a.b, unless it is
derived in `derived.py`.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.build.derived import event_values, group_values, lane_groups, plan_values, schur_sizes
from phfmu.engine.build.runtime_sources import RUNTIME
from phfmu.engine.model import EngineModel
from phfmu.events.event_plan import EventPlan
from phfmu.plan.plan import Kernel, Plan
from phfmu.schur.stepper import SchurStepper

SCALARS = {"int": ctypes.c_int, "double": ctypes.c_double, "uint64_t": ctypes.c_uint64}
ARRAYS = {"int": np.int32, "double": np.float64, "signed char": np.int8}
STRUCTS = ("ph_elimination", "ph_lane_group", "ph_schur", "ph_group", "ph_plan", "ph_model", "ph_events", "ph_switches",
           "ph_mode_rows", "ph_program", "ph_programs", "ph_ports")  # fmt: skip
HEADERS = ("schur/schur.h", "plan.h", "events/events.h", "modes/modes.h", "interpret/interpret.h", "impulses.h")


@dataclass(frozen=True)
class Field:
    """One member of a C structure; `pointer`: to values of type `ctype`, and `constant` if nobody writes there."""

    name: str
    ctype: str
    pointer: bool
    constant: bool = True


@lru_cache(maxsize=1)
def structures() -> dict[str, tuple[Field, ...]]:
    """Members of the structures of HEADERS, in order."""
    return declared("".join((RUNTIME / name).read_text() for name in HEADERS), STRUCTS)


def declared(header: str, names: Sequence[str]) -> dict[str, tuple[Field, ...]]:
    """Members of the structures `names` in the text of a header: plain sizes and pointers, in order.

    Members may go on over lines.  ValueError, with the member, for one of another kind: without it all that follow would lie
    elsewhere than in C.
    """
    text = re.sub(r"/\*.*?\*/", "", header, flags=re.S)
    bodies = dict(re.findall(r"typedef struct (\w+) \{(.*?)\} \1;", text, flags=re.S))
    return {name: tuple(_fields(name, bodies[name])) for name in names}


def _fields(struct: str, body: str) -> Iterator[Field]:
    """The members in the text between the braces of a structure."""
    for member in (" ".join(part.split()) for part in body.split(";")[:-1]):
        match = re.fullmatch(r"(const )?([a-z_0-9]+(?: char)?) ?(\*?) ?(\w+(?:, \w+)*)", member)
        if not match:
            raise ValueError(
                f"{struct}: the member '{member}' is neither a plain value nor one pointer; declare it as one of these"
            )
        for name in match[4].split(", "):
            yield Field(name, match[2], bool(match[3]), bool(match[1]))


@lru_cache(maxsize=1)
def ctypes_structures() -> dict[str, type[ctypes.Structure]]:
    """The structures of the headers for ctypes, by name."""
    return for_ctypes(structures())


def for_ctypes(found: Mapping[str, tuple[Field, ...]]) -> dict[str, type[ctypes.Structure]]:
    """Structures for ctypes; every pointer is a void pointer."""
    return {
        name: type(
            name,
            (ctypes.Structure,),
            {"_fields_": [(f.name, ctypes.c_void_p if f.pointer else SCALARS[f.ctype]) for f in fields]},
        )
        for name, fields in found.items()
    }


def stamp() -> int:
    """PH_STAMP of plan.h as this interpreter lays the structures out."""
    version = re.search(r"#define PH_VERSION (\d+)", (RUNTIME / "plan.h").read_text())
    assert version
    model, plan, group = (ctypes.sizeof(ctypes_structures()[n]) for n in ("ph_model", "ph_plan", "ph_group"))
    return int(version[1]) << 48 | model << 32 | plan << 16 | group


def _value(source: Any, derived: dict[str, Any], name: str) -> Any:
    if name in derived:
        return derived[name]
    if hasattr(source, name):
        return getattr(source, name)
    head, _, tail = name.partition("_")
    return getattr(derived.get(head, getattr(source, head, None)), tail)


def _members(struct: str, source: Any, derived: dict[str, Any]) -> Iterator[tuple[Field, Any]]:
    """Fields with their values; arrays flat, contiguous and of the type the field has."""
    for field in structures()[struct]:
        value = _value(source, derived, field.name)
        if field.pointer and field.ctype in ARRAYS:
            value = np.ascontiguousarray(np.asarray(value).ravel(), ARRAYS[field.ctype])
        yield field, value


class TableMemory:
    """Structures for ctypes with the arrays they point to, which live as long as this object."""

    def __init__(self) -> None:
        self._keep: list[Any] = []

    @property
    def size(self) -> int:
        """Bytes of the tables."""
        return sum(k.nbytes if isinstance(k, np.ndarray) else ctypes.sizeof(k) for k in self._keep)

    def fill(self, name: str, source: Any, derived: dict[str, Any]) -> ctypes.Structure:
        """The structure of that name; `derived` goes before attributes of `source`."""
        struct = ctypes_structures()[name]()
        for field, value in _members(name, source, derived):
            if isinstance(value, np.ndarray):
                self._keep.append(value)
                value = value.ctypes.data if value.size else None
            setattr(struct, field.name, value)
        self._keep.append(struct)
        return struct

    def groups(self, items: Sequence[tuple[Any, dict[str, Any]]]) -> int:
        """Address of an array of groups."""
        rows = [self.fill("ph_group", g, values) for g, values in items]
        array = (ctypes_structures()["ph_group"] * len(rows))(*rows)
        self._keep.append(array)
        return ctypes.addressof(array)


class CTables(TableMemory):
    """A model as ctypes structures; `pointer` is valid as long as this object lives.  `code`: address of its ph_code."""

    def __init__(self, model: EngineModel, index: Callable[[Kernel], int], code: int) -> None:
        super().__init__()
        self._plans: CTables | None = None  # tables whose plans these are
        self._index = index
        self._derived = {"stamp": stamp(), "tangents": None, "slopes": None, "code": code}
        self._derived |= {name: self._plan(getattr(model, name)) for name in ("step", "instant")}
        self._model = self.fill("ph_model", model, self._derived)
        self.pointer = ctypes.addressof(self._model)
        #: structure of the state events, None without
        self.events = None if model.events is None else self._events(model.events)

    def like(self, model: EngineModel) -> CTables:
        """Tables of a model on the same plans: start values of its own, all else is that of these."""
        other = copy(self)
        other._keep, other._plans = [], self
        other._model = other.fill("ph_model", model, self._derived)
        other.pointer = ctypes.addressof(other._model)
        return other

    def with_tangents(self, model: EngineModel, address: int) -> CTables:
        """Tables of the same model with the ph_functions at `address`."""
        other = self.like(model)
        other._model.tangents = address
        return other

    def _plan(self, plan: Plan) -> int:
        derived = plan_values(plan, self._index)
        at = self.groups(derived["groups"])
        schur = None if plan.schur is None else self._schur(plan.schur)
        struct = self.fill("ph_plan", plan, derived | {"groups": at, "schur": schur})
        return ctypes.addressof(struct)

    def _events(self, plan: EventPlan) -> int:
        at, size = self.groups(_event_groups(plan, self._index)), ctypes.sizeof(ctypes_structures()["ph_group"])
        rates = at + size * len(plan.groups)
        derived = event_values(plan) | {"groups": at, "rates": rates}
        derived["jump"] = None if plan.jump is None else rates + size * len(plan.rates)
        return ctypes.addressof(self.fill("ph_events", plan, derived))

    def _schur(self, schur: SchurStepper) -> int:
        rows = [self.fill("ph_lane_group", g, values) for g, values in lane_groups(schur)]
        array = (ctypes_structures()["ph_lane_group"] * len(rows))(*rows)
        self._keep.append(array)
        derived = schur_sizes(schur) | {"groups": ctypes.addressof(array)}
        for name in ("hard", "soft"):
            part = getattr(schur, name)
            derived[name] = None if part is None else ctypes.addressof(self.fill("ph_elimination", part, {}))
        return ctypes.addressof(self.fill("ph_schur", schur, derived))


def _event_groups(plan: EventPlan, index: Callable[[Kernel], int]) -> list[tuple[Any, dict[str, Any]]]:
    """Groups of the guards and of their rates, then that of the jumps; all their rows are reports."""
    groups = [*plan.groups, *plan.rates, *(() if plan.jump is None else (plan.jump.group,))]
    return [(g, group_values(g, 0, index)) for g in groups]


def array_text(ctype: str, name: str, values: NDArray[Any]) -> str:
    """C text of a constant array."""
    infinite = {inf: "INFINITY", -inf: "-INFINITY"}
    items = [infinite.get(v) or repr(v) for v in values.tolist()]
    lines, line = [], "   "
    for item in items:
        if len(line) + len(item) + 2 > 110:
            lines.append(line)
            line = "   "
        line += f" {item},"
    return f"static const {ctype} {name}[] = {{\n" + "\n".join([*lines, line]) + "\n};\n"


def struct_text(struct: str, name: str, source: Any, derived: dict[str, Any]) -> tuple[str, str]:
    """Text of the arrays of one structure, and its initialiser."""
    arrays, members = "", []
    for field, value in _members(struct, source, derived):
        if isinstance(value, np.ndarray):
            if value.size:
                arrays += array_text(field.ctype, f"{name}_{field.name}", value)
            value = f"{name}_{field.name}" if value.size else "0"
        members.append(f"    .{field.name} = {value},")
    return arrays, "{\n" + "\n".join(members) + "\n}"


def array_of_structs(struct: str, name: str, items: Sequence[tuple[Any, dict[str, Any]]]) -> str:
    """Text of an array of structures and of the arrays they point to; nothing for none."""
    text, rows = "", []
    for i, (source, values) in enumerate(items):
        arrays, members = struct_text(struct, f"{name}_{i}", source, values)
        text += arrays
        rows.append(members)
    return text + (f"static const {struct} {name}[] = {{\n" + ",\n".join(rows) + "\n};\n" if rows else "")


def schur_text(schur: SchurStepper, name: str) -> str:
    """C source that defines `static const ph_schur <name>`."""
    text = array_of_structs("ph_lane_group", f"{name}_groups", lane_groups(schur))
    derived = schur_sizes(schur) | {"groups": f"{name}_groups"}
    for part in ("hard", "soft"):
        derived[part] = "0"
        if getattr(schur, part) is None:
            continue
        arrays, members = struct_text("ph_elimination", f"{name}_{part}", getattr(schur, part), {})
        text += arrays + f"static const ph_elimination {name}_{part} = {members};\n"
        derived[part] = f"&{name}_{part}"
    arrays, members = struct_text("ph_schur", name, schur, derived)
    return text + arrays + f"static const ph_schur {name} = {members};\n"


def _plan_text(plan: Plan, name: str, index: Callable[[Kernel], int]) -> str:
    derived = plan_values(plan, index)
    text = array_of_structs("ph_group", f"{name}_groups", derived["groups"])
    derived["groups"] = f"{name}_groups" if plan.groups else "0"
    derived["schur"] = "0"
    if plan.schur is not None:
        text += schur_text(plan.schur, f"{name}_schur")
        derived["schur"] = f"&{name}_schur"
    arrays, members = struct_text("ph_plan", name, plan, derived)
    return text + arrays + f"static const ph_plan {name} = {members};\n"


def c_text(
    model: EngineModel,
    index: Callable[[Kernel], int],
    symbol: str = "ph_the_model",
    tangents: str = "0",
    code: str = "ph_the_code",
    slopes: str = "0",
) -> str:
    """C source that defines `const ph_model <symbol>`; the same model gives the same bytes."""
    derived = {
        "stamp": "PH_STAMP",
        "step": "&step",
        "instant": "&instant",
        "code": f"&{code}",
        "tangents": tangents,
        "slopes": slopes,
    }
    arrays, members = struct_text("ph_model", "model", model, derived)
    return (
        '#include "plan.h"\n\n'
        + "".join(
            f"extern const {kind};\n"
            for kind in (f"ph_code {code}", f"ph_function {tangents}[]", f"ph_function {slopes}[]")
            if " 0[" not in kind
        )
        + _plan_text(model.step, "step", index)
        + _plan_text(model.instant, "instant", index)
        + arrays
        + f"extern const ph_model {symbol};\nconst ph_model {symbol} = {members};\n"
    )


def events_text(plan: EventPlan, index: Callable[[Kernel], int], symbol: str = "ph_the_events") -> str:
    """C source that defines `const ph_events <symbol>`."""
    groups = array_of_structs("ph_group", "events_groups", _event_groups(plan, index))
    derived = event_values(plan) | {"groups": "events_groups" if groups else "0"}
    derived["rates"] = f"events_groups + {len(plan.groups)}" if plan.rates else "0"
    jump = len(plan.groups) + len(plan.rates)
    derived["jump"] = "0" if plan.jump is None else f"events_groups + {jump}"
    arrays, members = struct_text("ph_events", "events", plan, derived)
    return (
        '#include <math.h>\n\n#include "events.h"\n\n'
        + groups
        + arrays
        + f"extern const ph_events {symbol};\nconst ph_events {symbol} = {members};\n"
    )
