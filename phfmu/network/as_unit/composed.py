"""Members that land as one composed declaration, as a unit has them: with ideal switches, or guards that read what others give.

The composed declaration is there in each mode of its switches, and takes no step: guards, modes and jumps are asked of it.  Steps
are the members' own, under the rows of the junctions in the present mode (`couplings/landing/composed_lander.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model
from phfmu.discretise.within import polynomial_of
from phfmu.engine.build.codegen import kernel_table
from phfmu.engine.build.tables import array_text, c_text, events_text
from phfmu.engine.model import kernels
from phfmu.events.polynomial import guard_fit
from phfmu.fmu.export.unit_modes import ROWS, SWITCHES, UnitModes, events_symbol, model_symbol, unit_modes
from phfmu.fmu.words import c_string
from phfmu.fmu.xml import number
from phfmu.network.couplings.compiled.master_pattern import MasterPattern, exchange_tables
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.couplings.unconverged import plain
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.relation import RelationInstance
from phfmu.plan.ordering import StructurallySingular

Array = NDArray[Any]

#: functions of `ph_lander`
_FUNCTIONS = ("make", "release", "land", "start", "reset", "state_size", "save", "load", "fault", "refusal")
#: lists of `ph_junction_rows` -> their type in C
_LISTS = {
    "skew_row": "int", "skew_col": "int", "skew_entry": "int", "skew": "double", "colptr": "int", "rowind": "int", "order": "int",
    "prefer": "int",
}  # fmt: skip


@dataclass(frozen=True)
class JunctionRows:
    """The rows of the junctions in a mode: `ph_junction_rows`; `entry`: of each share.  No lists: they cannot be solved."""

    lists: dict[str, Array] = field(default_factory=dict)
    entry: tuple[Array, ...] = ()
    nskew: int = 0
    nnz: int = 0
    capacity: int = 0


@dataclass(frozen=True, eq=False)
class ComposedEvents:
    """`whole`: the coupled members;  `models`: theirs;  `step`: longest internal step, s."""

    whole: Coupled
    models: tuple[Model, ...]
    step: float

    @property
    def _landing(self) -> Any:
        return self.whole.switching

    @property
    def model(self) -> Model:
        """The composed declaration, in the mode of the start."""
        return self._landing.model

    @cached_property
    def modes(self) -> UnitModes | None:
        """All modes of its switches; None without any.  FMUError if there are too many."""
        return unit_modes(self.model)

    @cached_property
    def relations(self) -> dict[int, RelationInstance]:
        """Members that are switches and nothing else, by their numbers."""
        members = enumerate(self.whole.joined.members)
        return {
            i: m.instance
            for i, m in members
            if isinstance(m, EngineMember) and isinstance(m.instance, RelationInstance)
        }

    @cached_property
    def rows(self) -> tuple[list[JunctionRows], list[int]]:
        """The different rows of the junctions, and which of them each mode has."""
        if self.modes is None:
            return [], [0]
        found, where = dict[bytes, int](), list[int]()
        rows = list[JunctionRows]()
        for mode in self.modes.rows:
            self._landing.in_mode(tuple(int(s) for s in mode.on))
            own = self._rows()
            key = b"".join(np.asarray(a).tobytes() for a in own.lists.values())
            if key not in found:
                found[key] = len(rows)
                rows.append(own)
            where.append(found[key])
        self._landing.in_mode(self.model.modes.modes.start)  # type: ignore[union-attr]
        return rows, where

    def _rows(self) -> JunctionRows:
        e = exchange_tables(self.whole.joined, plain(self.whole.coupling))
        try:
            p = MasterPattern(e)
        except StructurallySingular:
            return JunctionRows()
        lists = {
            "skew_row": e.skew_row, "skew_col": e.skew_col, "skew_entry": p.skew, "skew": e.skew, "colptr": p.colptr,
            "rowind": p.rowind, "order": p.order, "prefer": p.prefer,
        }  # fmt: skip
        return JunctionRows(lists, tuple(p.entries), len(e.skew), len(p.rowind), p.capacity)

    @property
    def entries(self) -> int:
        """Most entries of the matrix."""
        return max((r.nnz for r in self.rows[0]), default=0)

    # -- C ------------------------------------------------------------------------------------------------------------

    def files(self) -> dict[str, str]:
        """C files of the composed declaration, as those of the unit of one model."""
        model, modes = self.model, self.modes
        assert model.events is not None
        table = kernel_table([*kernels(model), *(modes.kernels if modes else ())], model.step.schur)
        files = {
            "kernels.c": table.text,
            "model.c": c_text(model, table.index),
            "guards.c": events_text(model.events, table.index),
        }
        return files | (modes.texts(table, "0") if modes else {})

    def fields(self) -> str:
        """Fields of ph_network."""
        rows = f"    .nrows = {len(self.rows[0])},\n    .rows = junction_rows,\n" if self.rows[0] else ""
        return f"    .lander = &lander,\n{rows}"

    def relation_text(self, i: int) -> str:
        """C text that defines `relation<i>`, the ph_embedded of member number i."""
        r = self.relations[i]
        _, at, observed = next(t for t in self._landing.told if t[0] is r)
        places, p = r.modes, r.parameters
        matrices = list[Array]()
        for sides in product((0.0, 1.0), repeat=len(places)):
            p[places] = sides[::-1]  # the first switch is the last digit
            matrices.append(r.rows(p)[0])
        step = r.model.step
        arrays = {
            "weights": ("double", r.model.scheme.nodes.b), "place": ("int", np.array(places, np.int32)),
            "B": ("double", np.array(matrices).ravel()), "p": ("double", r.model.p0), "a": ("double", r.model.a0),
            "at": ("int", np.asarray(at, np.int32)), "observed": ("int", np.asarray(observed, np.int32)),
        }  # fmt: skip
        text = "".join(array_text(kind, f"relation{i}_{n}", a) for n, (kind, a) in arrays.items() if len(a))
        sizes = {
            "nu": r.nu,
            "na": r.na,
            "np": step.np,
            "nobs": len(observed),
            "ncomp": step.ncomp,
            "k": step.k,
            "n": len(places),
        }
        members = [f".{n} = {v}" for n, v in sizes.items()]
        members += [f".{n} = relation{i}_{n}" for n, (_, a) in arrays.items() if len(a)]
        about = f"static const ph_relation relation{i}_about = {{{', '.join(members)}}};\n"
        parts = f"&relation{i}_about, ph_map_relation, ph_kind_relation, 0, 0"
        return f"{text}{about}static const ph_embedded relation{i} = {{{parts}}};\n"

    def text(self) -> str:
        """C text that defines `lander`, a ph_lander, and the rows of the junctions."""
        events = self.model.events
        assert events is not None
        members = range(len(self.models))
        landing = self._landing
        lists = {
            "members": np.arange(len(self.models)), "free": landing.members_state.unfed, "column": landing.columns,
            "relations": np.array([*self.relations]), "unknown": np.array(self._unknowns()),
        }  # fmt: skip
        text = "".join(array_text("int", f"landing_{n}", np.asarray(a, np.int32)) for n, a in lists.items() if len(a))
        own = [self._polynomial(i) for i in members]
        text += "".join(t for t, _ in own) + self._rows_text() + self._modes_text()
        names = ", ".join(map(c_string, events.names))
        functions = "".join(f", .{f} = ph_composed_{f}" for f in _FUNCTIONS)
        functions += ", .clear = ph_relation_clear" if self.relations else ""
        places = {n: f"landing_{n}" if len(a) else "0" for n, a in lists.items()}
        switches = f".switches = &{SWITCHES}, .mode_rows = {ROWS}, .names = switch_names, " if self.modes else ""
        return (
            f"{text}static const char *const landing_names[] = {{{names}}};\n"
            f"static const ph_events *const landing_own[] = {{{', '.join(name for _, name in own)}}};\n"
            f"static const ph_composed composed = {{.nmode = {len(self.rows[1])}, .modes = composed_modes, {switches}"
            f".free = {places['free']}, .column = {places['column']}, .nrelation = {len(self.relations)}, "
            f".relations = {places['relations']}, .unknown = {places['unknown']}, .step = {number(self.step)}}};\n"
            "static const ph_lander lander = {.model = &ph_the_model, .events = &ph_the_events, .names = landing_names, "
            f".n = {len(members)}, .members = {places['members']}, .own = landing_own, .composed = &composed{functions}}};\n"
        )

    def _unknowns(self) -> list[int]:
        """The first common variable of each relation."""
        ends = np.cumsum([len(self.whole.joined.face.names), *(r.na for r in self.relations.values())])
        return [int(first) for first, _ in pairwise(ends.tolist())]

    def _modes_text(self) -> str:
        """The composed declaration in its modes, and the names of its switches."""
        modes, where = self.modes, self.rows[1]
        models = range(len(where))
        text = "".join(
            f"extern const ph_model {model_symbol(i)};\nextern const ph_events {events_symbol(i)};\n" for i in models
        )
        rows = ", ".join(f"{{&{model_symbol(i)}, &{events_symbol(i)}, {where[i]}}}" for i in models)
        text += f"static const ph_composed_mode composed_modes[] = {{{rows}}};\n"
        if modes is None:
            return text
        names = ", ".join(map(c_string, modes.names))
        return (
            f"extern const ph_switches {SWITCHES};\nextern const ph_mode_rows {ROWS}[];\n{text}"
            f"static const char *const switch_names[] = {{{names}}};\n"
        )

    def _rows_text(self) -> str:
        text, structs = "", []
        for i, r in enumerate(self.rows[0]):
            named = {n: f"rows{i}_{n}" for n, a in r.lists.items() if len(a)}
            text += "".join(array_text(_LISTS[n], name, np.asarray(r.lists[n])) for n, name in named.items())
            entries = [f"rows{i}_entry{j}" if len(e) else "0" for j, e in enumerate(r.entry)]
            named_entries = zip(entries, r.entry, strict=True)
            text += "".join(array_text("int", n, np.asarray(e, np.int32)) for n, e in named_entries if len(e))
            text += f"static const int *const rows{i}_entry[] = {{{', '.join(entries) or '0'}}};\n"
            fields = "".join(f", .{n} = {name}" for n, name in named.items())
            structs.append(
                f"{{.nskew = {r.nskew}, .nnz = {r.nnz}, .capacity = {r.capacity}{fields}, .entry = rows{i}_entry}}"
            )
        return text + (
            f"static const ph_junction_rows junction_rows[] = {{{', '.join(structs)}}};\n" if structs else ""
        )

    def _polynomial(self, i: int) -> tuple[str, str]:
        """The polynomial of the states of member number i within its steps, and its name in C."""
        if self.models[i].step.nx == 0:
            return "", "0"
        p, found = polynomial_of(self.models[i]), guard_fit(self.models[i].step.k)
        weights = [p.nodes.integral(float(t)) for t in found.tau]
        arrays: dict[str, Any] = {"fit_tau": found.tau, "fit_weights": np.array(weights)}
        arrays |= {f"polynomial_{n}": getattr(p, n) for n in ("state", "w", "node", "start_state", "start_w")}
        name = f"polynomial{i}"
        text, fields = "", [f".npoint = {len(found.tau)}", f".nincrement = {len(p.w)}", f".nstart = {len(p.start_w)}"]
        for n, a in arrays.items():
            kind = "double" if n.startswith("fit_") else "int"
            if len(a):
                text += array_text(kind, f"{name}_{n}", np.asarray(a, float if kind == "double" else np.int32).ravel())
                fields.append(f".{n} = {name}_{n}")
        return f"{text}static const ph_events {name} = {{{', '.join(fields)}}};\n", f"&{name}"


def not_composed(whole: Coupled) -> str:
    """Why a unit cannot land as the composed declaration of its members does in a run; "" if it can."""
    for m in whole.joined.members:
        if not isinstance(m, EngineMember) or m.model.modes is None:
            continue
        if not isinstance(m.instance, RelationInstance):
            return (
                f"{m.name} has ideal switches beside states, losses or free ports, so that its own steps change with the mode, "
                "which those of a member inside a unit do not"
            )
        if given := m.instance.given_by:
            return f"the rows of the ideal switches of {m.name} follow from parameters too ({', '.join(given[:4])})"
    return ""
