"""Members that land on state events together, as a unit has them: a model with their states side by side, whose guards they are.

The model takes no steps.  A single member with events is that model itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from phfmu.discretise.model import Model
from phfmu.engine.build.codegen import kernel_table
from phfmu.engine.build.tables import array_text, c_text, events_text
from phfmu.engine.model import kernels
from phfmu.events.event_plan import EventPlan
from phfmu.fmu.words import c_string
from phfmu.network.as_unit.composed import not_composed
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.couplings.landing.side_by_side import side_by_side, without_inputs
from phfmu.network.couplings.newton import Newton
from phfmu.network.couplings.unconverged import plain
from phfmu.network.members.engine_member import EngineMember

#: functions of `ph_lander`
_FUNCTIONS = ("make", "release", "land", "state_size", "save", "load", "fault", "refusal")


@dataclass(frozen=True, eq=False)
class Landers:
    """Models of the members with events, in their order;  members: their numbers;  names: theirs;  size: of the network."""

    models: tuple[Model, ...]
    members: tuple[int, ...]
    names: tuple[str, ...]
    size: int

    @cached_property
    def model(self) -> Model:
        """The states, parameters and events of the members side by side."""
        return side_by_side(dict(zip(self.names, self.models, strict=True)))

    def plan(self, i: int) -> EventPlan:
        """The events of member number i; rates that read inputs, which others give, are not known."""
        return without_inputs(self.models[self.members.index(i)])

    @property
    def _number(self) -> int:
        """Number in the names of the C files of the model."""
        return self.members[0] if len(self.models) == 1 else self.size

    def files(self) -> dict[str, str]:
        """C files of the model, where it is none of a member."""
        if len(self.models) == 1:
            return {}
        n, model = self.size, self.model
        table = kernel_table(kernels(model), model.step.schur, f"ph_code{n}")
        return {
            f"kernels{n}.c": table.text,
            f"member{n}.c": c_text(model, table.index, f"ph_member{n}", "0", f"ph_code{n}"),
            f"guards{n}.c": events_text(without_inputs(model), table.index, f"ph_guards{n}"),
        }

    def fields(self) -> str:
        """Fields of ph_network."""
        return "    .lander = &lander,\n"

    def text(self) -> str:
        """C text that defines `lander`, a ph_lander."""
        n = self._number
        names = [f"{m}.{g}" for m, model in zip(self.names, self.models, strict=True) for g in model.events.names]  # type: ignore[union-attr]
        functions = "".join(f", .{f} = ph_lander_{f}" for f in _FUNCTIONS)
        externs = (
            f"extern const ph_model ph_member{n};\nextern const ph_events ph_guards{n};\n" if n == self.size else ""
        )
        own = ", ".join(f"&ph_guards{i}" for i in self.members)
        return (
            f"{externs}static const char *const landing_names[] = {{{', '.join(map(c_string, names))}}};\n"
            f"{array_text('int', 'landing_members', np.array(self.members, np.int32))}"
            f"static const ph_events *const landing_own[] = {{{own}}};\n"
            f"static const ph_lander lander = {{.model = &ph_member{n}, .events = &ph_guards{n}, .names = landing_names, "
            f".n = {len(self.members)}, .members = landing_members, .own = landing_own{functions}}};\n"
        )


def not_landed(whole: Coupled) -> str:
    """Why a unit cannot land on the state events of members as a run does; "" if it can."""
    together = [m for m in whole.joined.members if isinstance(m, EngineMember) and m.together]
    inside = [m.name for m in whole.joined.members if isinstance(m, EngineMember) and m.model.events and not m.together]
    names = ", ".join(m.name for m in together[:4])
    exchange = inner.exchange if isinstance(inner := plain(whole.coupling), Newton) else None
    if exchange is not None and exchange.whole:
        return not_composed(whole)
    if switched := [m.name for m in whole.joined.members if isinstance(m, EngineMember) and m.model.modes is not None]:
        return (
            f"{', '.join(switched[:4])} have ideal switches, which land inside the steps of their members, not as one composed "
            "declaration"
        )
    units = [m for m in whole.joined.members if not isinstance(m, EngineMember)]
    if together and units:
        return (
            f"{names} land on state events together with units of other tools ({', '.join(m.name for m in units[:4])})"
        )
    if inside and (lost := [m.name for m in units if not m.saves]):
        return f"{', '.join(inside[:4])} have state events, and {', '.join(lost[:4])} cannot save their states"
    if together and inside:
        return f"{names} land on state events together with all others, and {', '.join(inside[:4])} inside their steps"
    if exchange is not None and (shared := [m.name for m in together if m.name in exchange.shared.of]):
        return f"jumps of {', '.join(shared[:4])} act on other members"
    if len({m.model.step.k for m in together}) > 1:
        return f"{names} land together and have different orders"
    return ""
