"""The equations of all modes as tables and kernels, for compiled code that changes modes itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from phfmu.declare.variable import time
from phfmu.events.event_plan import EventPlan
from phfmu.events.modes import Mode, Modes
from phfmu.plan.address import Address, row
from phfmu.plan.plan import Floats, Group, Ints, Kernel, Plan, Powers
from phfmu.plan.spec import Spec, build


@dataclass(frozen=True, eq=False)
class SwitchTables:
    """n switches of a model: `ph_switches`, whose fields are told in runtime/modes/modes.h."""

    n: int
    nevent: int
    nx: int
    na: int
    nu: int
    np: int
    ncomp: int
    a_end: int
    told: int
    nresult: int
    groups: tuple[Group, Group]
    place: Ints
    multiplier: Ints
    owner: Ints
    unilateral: Powers
    gaps: Powers
    nominal: Floats
    most: Floats
    size: Floats
    scale: Floats
    when_ptr: Ints
    when_p: Ints
    when_value: Floats

    @property
    def kernels(self) -> list[Kernel]:
        return [g.kernel for g in self.groups]


@dataclass(frozen=True, eq=False)
class ModeRows:
    """The rows of a mode that are known without its model: `ph_mode_rows`."""

    nfree: int
    on: Powers
    free_at: Ints
    free_row: Floats


def switch_tables(modes: Modes, plan: Plan, events: EventPlan, observables: int) -> SwitchTables:
    """The tables of a model in whose plan and state events all modes agree; `observables`: how many it has in all modes."""
    system, switches = modes.system, modes.switches
    a_end = plan.nx + 1 + plan.na + 2 * plan.nq + 3 * plan.ncomp
    equations = system.equations
    rates, size = _group(equations.x, [equations.a, equations.u], equations.p, equations.rows)
    energy, _ = _group(equations.x, [equations.a, equations.u], equations.p, [equations.gradients])
    place = {n: i for i, n in enumerate(modes.names)}
    return SwitchTables(
        len(switches), events.n, plan.nx, plan.na, plan.nu, plan.np, plan.ncomp,
        a_end, a_end + plan.na + plan.nq + observables, size, (rates, energy),
        np.array(system.places, np.int32), np.array(system.multipliers, np.int32), np.array(system.owners, np.int32),
        np.array([s.unilateral for s in switches], np.int8), np.array([s.gap is not None for s in switches], np.int8),
        np.array([s.nominal for s in switches], float), np.array([s.most for s in switches], float), system.size, system.nominal,
        np.cumsum([0, *(len(s.when) for s in switches)]).astype(np.int32),
        np.array([place[n] for s in switches for n in s.when], np.int32),
        np.array([v for s in switches for v in s.when.values()], float),
    )  # fmt: skip


def mode_rows(modes: Modes, mode: Mode) -> ModeRows:
    """The directions that no row of a mode determines."""
    found = modes.system.undetermined(mode)
    rows = np.array([u.row for u in found], float).ravel()
    return ModeRows(len(found), np.array(mode, np.int8), np.array([u.at for u in found], np.int32), rows)


def _group(x: ca.SX, y: Sequence[ca.SX], p: ca.SX, results: Sequence[ca.SX]) -> tuple[Group, int]:
    """One kernel of dense results by columns, of which zeros are left out; their whole length."""
    column = ca.sparsify(ca.vertcat(ca.SX(0, 1), *(ca.vec(ca.densify(r)) for r in results)))
    where = column.sparsity().get_triplet()[0]
    out = [(Address(row, j), 0, e) for j, e in enumerate(ca.vertsplit(ca.SX(column.nz[:])) if where else [])]
    inside = (
        [(Address(row, j), s) for j, s in enumerate(ca.vertsplit(ca.vertcat(*y)))] if sum(s.numel() for s in y) else []
    )
    kernel = build(Spec(1, ca.vertcat(x, time), p, inside, out, report=True))
    tables = [range(kernel.nx), range(kernel.ny), range(kernel.np), where]
    arrays = [np.array(list(t), np.int32).reshape(1, -1) for t in tables]
    return Group(
        kernel, 1, 1, *arrays, power=np.zeros(len(where), np.int8), owner=np.zeros(1, np.int32)
    ), column.numel()
