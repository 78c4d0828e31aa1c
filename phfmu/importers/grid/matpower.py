"""Cases of MATPOWER and networks of pandapower, both as MATPOWER's matrices; the extra `grid` brings their readers."""

from __future__ import annotations

from collections.abc import Sequence
from math import radians
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from phfmu.importers.grid.table import Bus, Demand, Generator, Grid, GridError, Line, Shunt, Transformer

#: a matrix of a case: its rows
Rows = list[list[float]]


def read_matpower(path: str | PathLike[str], *, frequency: float = 60.0) -> Grid:
    """A case of MATPOWER (.m), read by matpowercaseframes; `frequency` [Hz], which such files do not have."""
    try:
        from matpowercaseframes import CaseFrames  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ImportError("cases of MATPOWER need matpowercaseframes: pip install 'phfmu[grid]'") from None
    file = Path(path)
    if not file.is_file():
        raise GridError(str(path), ["there is no such file"])
    try:
        case: Any = CaseFrames(str(file))
        bus, branch, gen = (np.asarray(getattr(case, name), float) for name in ("bus", "branch", "gen"))
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        raise GridError(file.name, [f"it is no case of MATPOWER with bus, branch and gen ({error})"]) from None
    dc = getattr(case, "dcline", None)
    return _grid(
        file.stem, float(case.baseMVA), frequency, bus, branch, gen, [] if dc is None else [f"{len(dc)} DC lines"]
    )


def from_pandapower(net: Any, *, trafo_model: str = "pi") -> Grid:
    """A network of pandapower: its own matrices in the order of its buses, whose numbers they keep where each is one bus.

    `trafo_model`: the equivalent circuit of transformers, as in pandapower, of which magnetising branches at both ends (pi).
    """
    try:
        from pandapower.converter.pypower.to_ppc import to_ppc  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ImportError("networks of pandapower need pandapower: pip install 'phfmu[grid]'") from None
    case = to_ppc(
        net, calculate_voltage_angles=True, trafo_model=trafo_model, switch_rx_ratio=2, check_connectivity=True,
        voltage_depend_loads=False, init="flat", mode="pf",
    )  # fmt: skip
    lookup = net._pd2ppc_lookups["bus"]
    number = {int(lookup[k]): int(k) for k in reversed(list(net.bus.index))}
    bus, branch, gen = (np.real(np.array(case[name])).astype(float) for name in ("bus", "branch", "gen"))
    for rows, columns in ((bus, (0,)), (branch, (0, 1)), (gen, (0,))):
        for c in columns:
            rows[:, c] = [number.get(int(k), int(k)) for k in rows[:, c]]
    return _grid(net.name or "pandapower", float(case["baseMVA"]), float(net.f_hz), bus, branch, gen, [])


def _grid(
    name: str,
    base: float,
    frequency: float,
    bus: np.ndarray,
    branch: np.ndarray,
    gen: np.ndarray,
    unused: Sequence[str],
) -> Grid:
    """MATPOWER's matrices as a table; a branch with a ratio, a shift or unequal rated voltages is a transformer."""
    return _table(name, base, frequency, bus.tolist(), branch.tolist(), gen.tolist(), unused)


def _table(name: str, base: float, frequency: float, bus: Rows, branch: Rows, gen: Rows, unused: Sequence[str]) -> Grid:
    kv = {int(r[0]): r[9] or 1.0 for r in bus}
    missing = sorted({int(b) for r in branch for b in r[:2]} - set(kv))
    if missing:
        raise GridError(name, [f"branch to bus {b}, which is not there" for b in missing[:5]])
    lines: list[Line] = []
    transformers: list[Transformer] = []
    shunts = [Shunt(int(r[0]), "1", r[4], r[5]) for r in bus if r[4] or r[5]]
    met: dict[tuple[int, int], int] = {}
    for row in branch:
        i, j = int(row[0]), int(row[1])
        circuit = met[i, j] = met.get((i, j), 0) + 1
        on = len(row) < 11 or row[10] != 0
        if row[8] in (0.0, 1.0) and not row[9] and kv[i] == kv[j]:
            lines.append(Line(i, j, str(circuit), row[2], row[3], row[4], on=on))
            continue
        tap = row[8] or 1.0
        transformers.append(Transformer(i, j, str(circuit), row[2], row[3], tap, radians(row[9]), on=on))
        if row[4] and on:
            shunts += [
                Shunt(i, f"t{i}_{j}_{circuit}", 0.0, base * row[4] / 2 / tap**2),
                Shunt(j, f"t{i}_{j}_{circuit}", 0.0, base * row[4] / 2),
            ]
    held = {}
    for row in gen:
        held.setdefault(int(row[0]), row[5])
    count: dict[int, int] = {}
    generators = []
    for row in gen:
        at = int(row[0])
        count[at] = count.get(at, 0) + 1
        size = row[6] if row[6] > 0 else base
        q = (row[4], row[3])
        generators.append(Generator(at, str(count[at]), row[1], row[2], row[5], at, size, on=row[7] > 0, q_limits=q))
    return Grid(
        name, base, frequency,
        tuple(_bus(r, kv, held) for r in bus),
        tuple(lines), tuple(transformers), tuple(Demand(int(r[0]), "1", r[2], r[3]) for r in bus if r[2] or r[3]),
        tuple(shunts), tuple(generators), unused=tuple(unused),
    )  # fmt: skip


def _bus(row: list[float], kv: dict[int, float], held: dict[int, float]) -> Bus:
    number = int(row[0])
    return Bus(number, f"bus {number}", kv[number], int(row[1]), held.get(number, row[7]), radians(row[8]))
