"""The interface of a discretised model to an engine."""

from __future__ import annotations

from os import PathLike
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from phfmu.declare.error import Refusal
from phfmu.declare.phdae import PHDAE
from phfmu.events.event_plan import EventPlan
from phfmu.plan.plan import Kernel, Plan

Floats = NDArray[np.float64]


class EngineModel(Protocol):
    """Two plans and the start values: `step` advances the state by h, `instant` gives the values at one time.

    Starts x0 (nx), a0 (na), u0 (nu), p0 (np) in SI units, t0 in s.  Both plans share states, inputs,
    parameters, pairs, algebraics and components; `instant` has k = 1.
    `row_names`, `instant_names`: a name per residual row, `hold_names`: of the constraints that may rest, for messages.
    """

    @property
    def name(self) -> str: ...
    @property
    def declaration(self) -> PHDAE: ...
    @property
    def step(self) -> Plan: ...
    @property
    def instant(self) -> Plan: ...
    @property
    def events(self) -> EventPlan | None: ...
    @property
    def x0(self) -> Floats: ...
    @property
    def a0(self) -> Floats: ...
    @property
    def u0(self) -> Floats: ...
    @property
    def p0(self) -> Floats: ...
    @property
    def t0(self) -> float: ...
    @property
    def row_names(self) -> tuple[str, ...]: ...
    @property
    def hold_names(self) -> tuple[str, ...]: ...
    @property
    def instant_names(self) -> tuple[str, ...]: ...


def kernels(model: EngineModel) -> list[Kernel]:
    """Kernels of both plans, then of the state events, in order of appearance; an object may appear more than once."""
    more = [] if model.events is None else model.events.kernels
    return [*(g.kernel for plan in (model.step, model.instant) for g in plan.groups), *more]


def first(model: EngineModel) -> EngineModel | None:
    """The model whose plans it shares; None: they are its own, as are those of models made by hand or changed by `replace`."""
    found = getattr(model, "first", None)
    shared = found is not None and all(getattr(found, n) is getattr(model, n) for n in ("step", "instant", "events"))
    return found if shared else None


def require_built(model: object, engine: str) -> None:
    """Raise TypeError with the remedy if `model` is a declaration, or a name or file of one."""
    if isinstance(model, PHDAE | str | PathLike):
        shown = f"{type(model).__name__} {str(getattr(model, 'name', model))[:60]!r}"
        how = (
            "build_model(declaration)"
            if isinstance(model, PHDAE)
            else f"build_model(phfmu.target.load({str(model)!r}))"
        )
        raise TypeError(f"{engine} takes a model, got the {shown}; build it: {how}")


def require_one_mode(model: EngineModel) -> None:
    """Raise ValueError for a model with switches, of which an instance steps one mode only."""
    if getattr(model, "modes", None) is not None:  # models made by hand have none
        raise ValueError(
            f"{model.name} has switches: SwitchedInstance(model, NativeInstance) steps it in all its modes"
        )


def require_no_landing(model: EngineModel) -> None:
    """Raise Refusal for a model with state events or ideal switches, on which compiled code alone lands."""
    modes = getattr(model, "modes", None)
    if modes is not None:
        what, names = "switches", [s.name for s in modes.modes.switches]
    elif model.events is not None:
        what, names = "state events", list(model.events.names)
    else:
        return
    some = ", ".join(f"'{n}'" for n in names[:4]) + (", .." if len(names) > 4 else "")
    raise Refusal(
        model.name,
        f"the Python engine takes steps of a fixed grid and lands on no {what} ({some})",
        "take --engine native (NativeInstance), which lands on them; nothing is compiled for the model, as its kernels may "
        "run interpreted",
    )
