"""C text of coupled members: a `ph_network` with the tables of the members and those of the master.

The tables are what Python gives the compiled master of a run; what that writes to is memory of the unit.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from phfmu.discretise.model import Model
from phfmu.engine.build.codegen import kernel_table, port_text, tangent_text
from phfmu.engine.build.kernels import Kernels
from phfmu.engine.build.tables import ARRAYS, array_text, c_text, events_text
from phfmu.engine.impulses import port_kernels
from phfmu.engine.model import kernels
from phfmu.fmu.words import c_string
from phfmu.fmu.xml import number
from phfmu.network.as_unit.composed import ComposedEvents
from phfmu.network.as_unit.embedded import EmbeddedUnit
from phfmu.network.as_unit.landers import Landers
from phfmu.network.couplings.compiled.master import Master
from phfmu.network.couplings.compiled.master_library import HEADER, START_TRIALS
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.members.engine_member import EngineMember
from phfmu.signals import of_member

#: solver of the master -> its files besides those of Newton's
SOLVER_FILES = {
    "newton": (),
    "anderson": ("anderson.c", "anderson.h"),
    "in_turn": ("in_turn.c", "in_turn.h", "instant.c", "instant.h"),
}
#: fields that the unit fills in itself
_OWN: dict[str, set[str]] = {
    "ph_share": {"kind", "of", "free", "given", "outputs", "energies", "end", "clock"},
    "ph_native": {"in", "kicks", "chain", "signals", "values", "kept", "copied", "kept_values"},
    "ph_master": {"solver", "memory", "held", "rules", "shares", "lu", "work", "crew", "cost", "clock"},
}


@dataclass
class TableText:
    """Text of the tables, and the memory that is laid out for what is written to (bytes)."""

    arrays: list[str] = field(default_factory=list)
    room: int = 0

    def struct(self, kind: str, name: str, values: Mapping[str, Any]) -> tuple[str, list[str]]:
        """Initialiser of a structure in C, and rows of ph_room for its pointers into the memory."""
        members, rooms = [], []
        for f in HEADER.fields[kind]:
            value = values[f.name]
            if f.name in _OWN.get(kind, ()):
                continue
            if not f.pointer:
                members.append(f".{f.name} = {value!r}")
                continue
            array = np.ascontiguousarray(value, ARRAYS.get(f.ctype, np.float64)).ravel()
            if f.constant and array.size:
                self.arrays.append(array_text(f.ctype, f"{name}_{f.name}", array))
                members.append(f".{f.name} = {name}_{f.name}")
            elif not f.constant:
                rooms.append(f"{{offsetof({kind}, {f.name}), {self.room}}}")
                self.room += -(-array.nbytes // 16) * 16
        return "{" + ", ".join(members) + "}", rooms


def network_files(
    whole: Coupled,
    master: Master,
    members: Sequence[Model | EmbeddedUnit],
    step: float,
    landing: Landers | ComposedEvents | None,
) -> dict[str, str]:
    """kernels, tangents, models and ports of all members, and network.c: file name -> text; alike members share theirs."""
    together, relations = landing if isinstance(landing, Landers) else None, _relations(landing)
    models = {i: m for i, m in enumerate(members) if not isinstance(m, EmbeddedUnit) and i not in relations}
    guarded = {
        i: None if isinstance(landing, ComposedEvents) else together.plan(i) if together and i in together.members
        else m.events for i, m in models.items()
    }  # fmt: skip
    kicked = [native["kicks"] is not None for native in _filled(master, "ph_native")]
    ports = dict.fromkeys(range(len(members)), None) | {
        i: port_kernels(m.declaration) if k else None for (i, m), k in zip(models.items(), kicked, strict=True)
    }
    files, groups = dict[str, str](), dict[Any, list[int]]()
    for i, model in models.items():
        own = None if model.step.schur is None else i  # its solver is compiled for it alone
        groups.setdefault((Kernels(kernels(model)).token, own), []).append(i)
    for first, *_ in (numbers := list(groups.values())):
        alike = [models[i] for i in next(n for n in numbers if n[0] == first)]
        table = kernel_table([k for m in alike for k in kernels(m)], alike[0].step.schur, f"ph_code{first}")
        files[f"kernels{first}.c"] = table.text
        plans = [plan for m in alike for plan in (m.step, m.instant)]
        files[f"tangents{first}.c"] = tangent_text(table, *plans, symbol=f"ph_tangents{first}")
        for i in next(n for n in numbers if n[0] == first):
            tangents = f"ph_tangents{first}" if models[i].step.nu else "0"
            files[f"member{i}.c"] = c_text(models[i], table.index, f"ph_member{i}", tangents, f"ph_code{first}")
            if (events := guarded[i]) is not None:
                files[f"guards{i}.c"] = events_text(events, table.index, f"ph_guards{i}")
    made: dict[int, int] = {}
    for i, k in ports.items():
        if k is not None and made.setdefault(id(k), i) == i:
            files[f"ports{i}.c"] = port_text(k, f"ph_ports{i}")
    places = [None if ports[i] is None else made[id(ports[i])] for i in range(len(members))]
    files |= landing.files() if landing else {}
    return files | {"network.c": _network_text(whole, master, members, places, step, landing)}


def _relations(landing: Landers | ComposedEvents | None) -> Collection[int]:
    """Members that are ideal switches and nothing else."""
    return landing.relations if isinstance(landing, ComposedEvents) else ()


def _filled(master: Master, kind: str) -> list[Mapping[str, Any]]:
    return [values for name, values in master.memory.filled if name == kind]


def _network_text(
    whole: Coupled,
    master: Master,
    members: Sequence[Model | EmbeddedUnit],
    ports: Sequence[int | None],
    step: float,
    landing: Landers | ComposedEvents | None,
) -> str:
    tables, rows = TableText(), []
    together = landing if isinstance(landing, Landers) else None
    composed = landing if isinstance(landing, ComposedEvents) else None
    externs = ""
    shares, natives = _filled(master, "ph_share"), iter(_filled(master, "ph_native"))
    for i, (share, member, port) in enumerate(zip(shares, members, ports, strict=True)):
        length = np.zeros(share["length"])
        s, own = tables.struct("ph_share", f"share{i}", {**share, "record": length})
        if isinstance(member, EmbeddedUnit):
            more, what = list[str](), f".unit = &embedded{i}"
            part = master.found.parts[i]
            tables.arrays.append(member.text(f"embedded{i}", part.told, part.taken))
        elif composed and i in composed.relations:
            more, what = list[str](), f".unit = &relation{i}"
            tables.arrays.append(composed.relation_text(i))
        else:
            n, more = tables.struct("ph_native", f"native{i}", next(natives))
            what = f".model = &ph_member{i}, .ports = {'0' if port is None else f'&ph_ports{port}'}, .native = {n}"
            externs += f"extern const ph_model ph_member{i};\n"
            externs += "" if port is None else f"extern const ph_ports ph_ports{port};\n"
            if member.events is not None and not composed:
                externs += f"extern const ph_events ph_guards{i};\n"
                if not (together and i in together.members):
                    what += f", .inside = &inside{i}"
                    names = [of_member(whole.joined.members[i].name, n) for n in member.events.names]
                    tables.arrays.append(_inside(i, names))
        tables.arrays.append(_rooms(f"rooms{i}", [*own, *more]))
        rows.append(
            f"    {{{what},\n     .share = {s},\n"
            f"     .held = {int(master.found.parts[i].held)}, .nroom = {len(own)}, .nnative = {len(more)}, .rooms = rooms{i}}},\n"
        )
    (values,) = _filled(master, "ph_master")
    one = np.zeros(1, np.int32)
    memory = {"xi": np.zeros(2 * values["ncolumn"]), "trials": one, "accepted": one}
    if composed and composed.rows[0]:
        memory |= {"a": np.zeros(composed.entries), "scaled": np.zeros(composed.entries)}
    m, rooms = tables.struct("ph_master", "master", {**values, **memory})
    (rules,) = _filled(master, "ph_rules")
    first, pairs = junction_pairs(whole)
    lists = {
        "start": ("double", master.spread(whole.joined.face.start)), "free": ("double", whole.joined.free),
        "junction": ("int", first), "pair": ("int", pairs),
    }  # fmt: skip
    for name, (ctype, array) in lists.items():
        if len(array):
            tables.arrays.append(array_text(ctype, f"network_{name}", np.asarray(array, ARRAYS[ctype])))
    tables.arrays.append(_rooms("rooms", rooms))
    held = _held(tables, master)
    memory = _memory(tables, master)
    with_events = [i for i, m in enumerate(members) if not isinstance(m, EmbeddedUnit) and m.events is not None]
    headers = ["network_lander.h"] if together else []
    headers += ["composed_lander.h", "relation.h"] if composed else []
    inside = not composed and {*with_events} - {*(together.members if together else ())}
    headers += ["member_landing.h"] if inside else []
    if landing:
        tables.arrays.append(landing.text())
    given = "".join(f"    .{n} = {f'network_{n}' if len(a) else '0'},\n" for n, (_, a) in lists.items())
    return f"""\
/* Generated. The members of {len(rows)} models, and how they are coupled. */
#include <math.h>

#include "{"embedded.h" if any(isinstance(m, EmbeddedUnit) for m in members) else "network.h"}"
{"".join(f'#include "{name}"' + chr(10) for name in headers)}
{"".join(f'#include "{name}"' + chr(10) for name in SOLVER_FILES[master.solver] if name.endswith(".h"))}
{externs}
{"".join(tables.arrays)}
static const ph_network_member members[] = {{
{"".join(rows)}}};

extern const ph_network ph_the_network;
const ph_network ph_the_network = {{
    .nmember = {len(rows)},
    .members = members,
    .master = {m},
    .solver = ph_solver_{master.solver},
{memory}    .rules = {{{_rules(rules)}}},
    .nroom = {len(rooms)},
    .rooms = rooms,
{held}    .signals = {len(whole.joined.face.names)},
    .room = {tables.room},
    .step = {number(step)},
    .trials = {START_TRIALS if whole.from_short_steps or not any(isinstance(m, EmbeddedUnit) for m in members) else 1},
{given}{landing.fields() if landing else ""}    .njunction = {len(first) - 1},
}};
"""


def _inside(i: int, names: Sequence[str]) -> str:
    """The state events of member i, whose guards have these names."""
    listed = ", ".join(map(c_string, names))
    functions = "".join(f", .{n} = ph_inside_{n}" for n in ("make", "kind", "happened", "refusal"))
    return (
        f"static const char *const guards{i}[] = {{{listed}}};\n"
        f"static const ph_inside inside{i} = {{.events = &ph_guards{i}, .names = guards{i}{functions}}};\n"
    )


def _held(tables: TableText, master: Master) -> str:
    """Fields of the signals that are held over steps, if there are any."""
    for values in _filled(master, "ph_held"):
        own, rooms = tables.struct("ph_held", "held", {**values, "row": np.zeros(values["n"])})
        tables.arrays.append(_rooms("held_rooms", rooms))
        return f"    .held = {own},\n    .nheld = {len(rooms)},\n    .held_rooms = held_rooms,\n"
    return ""


def _rules(rules: Mapping[str, Any]) -> str:
    """Fields of `ph_rules` of a coupling that iterates."""
    whole = ", ".join(f".{name} = {int(rules[name])}" for name in ("held", "iterations", "accept"))
    return f"{whole}, .repeated = {number(float(rules['repeated']))}"


def _memory(tables: TableText, master: Master) -> str:
    """Fields of the memory of the solver, if it has one."""
    kind = f"ph_{master.solver}"
    for values in _filled(master, kind):
        own, rooms = tables.struct(kind, "memory", values)
        tables.arrays += [f"static const {kind} memory = {own};\n", _rooms("memory_rooms", rooms)]
        return (
            f"    .memory = &memory,\n    .memory_size = sizeof(memory),\n    .nmemory = {len(rooms)},\n"
            "    .memory_rooms = memory_rooms,\n"
        )
    return ""


def _rooms(name: str, rows: Sequence[str]) -> str:
    return f"static const ph_room {name}[] = {{{', '.join(rows) or '{0, 0}'}}};\n"


def junction_pairs(whole: Coupled) -> tuple[list[int], list[int]]:
    """First pair of each junction (junctions + 1), and the places of the pairs among those of all members."""
    joined = whole.joined
    first, at = dict[str, int](), 0
    for m in joined.members:
        first[m.name] = at
        at += m.model.step.nq if isinstance(m, EngineMember) else m.nu
    places = {m.name: m.places for m in joined.members}
    starts, pairs = [0], list[int]()
    for j in joined.network.junctions:
        for e in j.ends:
            own = places[e.member][e.port]
            pairs += range(first[e.member] + own.start, first[e.member] + own.stop)
        starts.append(len(pairs))
    return starts, pairs
