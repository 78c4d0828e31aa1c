"""Many steps as columns: what an engine hands over that steps faster than rows can be made."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from .rows import ESTIMATED, EXACT, SILENT
from .sums import Floats, Ints, across


@dataclass(frozen=True, slots=True)
class PortKey:
    """What stays the same of a `PortRow` from step to step; one column of a block."""

    component: str
    port: str
    index: int | None = None
    junction: str | None = None
    kind: str = "step-conjugate"
    quality: str = EXACT


@dataclass(frozen=True)
class Layout:
    """Names of a block's columns: c components, q scalar ports; the junctions follow from the ports.

    `silent`: components that tell nothing of their energy, neither by ports nor by books (foreign units).
    `absent`: (component, column) where a column that others fill does not exist, e.g. ("spring", "dissipated").
    """

    components: tuple[str, ...]
    ports: tuple[PortKey, ...] = ()
    silent: frozenset[str] = frozenset()
    absent: frozenset[tuple[str, str]] = frozenset()

    @cached_property
    def junctions(self) -> dict[str, list[int]]:
        """Port columns of each junction, in order of first appearance."""
        members: dict[str, list[int]] = {}
        for column, port in enumerate(self.ports):
            if port.junction is not None:
                members.setdefault(port.junction, []).append(column)
        return members

    @cached_property
    def external(self) -> list[tuple[int, float]]:
        """Port columns through which energy enters the balance, and the sign with which it does."""
        inside = set(self.components)
        return [
            (column, 1.0 if port.component in inside else -1.0)
            for column, port in enumerate(self.ports)
            if (port.component in inside) == (port.junction is None)
        ]

    @cached_property
    def owners(self) -> Floats:
        """1 where a port column belongs to a component [q,c]."""
        table = [[float(port.component == name) for name in self.components] for port in self.ports]
        return np.array(table).reshape(len(self.ports), len(self.components))

    @cached_property
    def with_ports(self) -> frozenset[str]:
        return frozenset(port.component for port in self.ports)

    @cached_property
    def estimated(self) -> frozenset[str]:
        return frozenset(port.component for port in self.ports if port.quality == ESTIMATED)

    def quality(self, component: str) -> str:
        """exact, estimated (a quadrature of its ports' power) or none."""
        if component in self.silent:
            return SILENT
        return ESTIMATED if component in self.estimated else EXACT

    def has(self, component: str, column: str) -> bool:
        return (component, column) not in self.absent


@dataclass(frozen=True, slots=True)
class Block:
    """n steps by columns: [n] per step, [n,c] per component, [n,q] per port, [n,junctions] per junction.

    `in_play` is what a residual is measured against: the energies that moved within the component (`moved`, or else
    max(|H0|, |H1|)), |supplied|, |dissipated|, |numerical| and |energy| of each port pair. `network` holds the fields of
    `NetworkRow` that are present, each [n]. Made by `make_block`.
    """

    layout: Layout
    step: Ints
    t0: Floats
    h: Floats
    H0: Floats
    H1: Floats
    dH: Floats
    residual: Floats
    in_play: Floats
    dissipated: Floats | None
    supplied: Floats | None
    moved: Floats | None
    newton: Ints | None
    substeps: Ints | None
    port_energy: Floats
    port_u: Floats | None
    port_y: Floats | None
    junction_residual: Floats
    junction_exchanged: Floats
    network: dict[str, Floats]
    numerical: Floats | None = None
    relative: Floats | None = None  # filled in by who judges it


def make_block(
    layout: Layout,
    step: ArrayLike,
    t0: ArrayLike,
    h: ArrayLike,
    H: ArrayLike,
    dH: ArrayLike,
    dissipated: ArrayLike | None = None,
    supplied: ArrayLike | None = None,
    port_energy: ArrayLike | None = None,
    port_u: ArrayLike | None = None,
    port_y: ArrayLike | None = None,
    *,
    H0: ArrayLike | None = None,
    moved: ArrayLike | None = None,
    newton: ArrayLike | None = None,
    substeps: ArrayLike | None = None,
    numerical: ArrayLike | None = None,
) -> Block:
    """Copy n steps into a block and derive residuals, junctions and the network balance.

    Shapes: step, t0 [n], h [n] or scalar; H (at the ends of the steps), dH, H0 (at their starts; default H - dH), dissipated,
    supplied, moved, newton, substeps, numerical [n,c]; port_energy, port_u, port_y [n,q].
    Errors: ValueError naming the array and both shapes.
    """
    steps = np.array(step, np.int64, ndmin=1)
    n, c, q = len(steps), len(layout.components), len(layout.ports)
    if q and port_energy is None:
        raise ValueError(f"the layout has {q} ports but port_energy is None; give it with shape {(n, q)}")
    times, widths = _table("t0", t0, (n,)), np.broadcast_to(np.array(h, float), (n,))
    ends, change = _table("H", H, (n, c)), _table("dH", dH, (n, c))
    lost, gained = _maybe("dissipated", dissipated, (n, c)), _maybe("supplied", supplied, (n, c))
    damped = _maybe("numerical", numerical, (n, c))
    within = _maybe("moved", moved, (n, c))
    energy = _table("port_energy", np.zeros((n, 0)) if port_energy is None else port_energy, (n, q))
    with np.errstate(invalid="ignore", over="ignore"):
        starts = ends - change if H0 is None else _table("H0", H0, (n, c))
        spent, got, gone = (0.0 if a is None else a for a in (lost, gained, damped))
        residual = change + spent + gone - got
        inside = np.maximum(np.abs(starts), np.abs(ends)) if within is None else np.abs(within)
        in_play = np.maximum(inside, np.abs(change)) + np.abs(got) + np.abs(spent) + np.abs(gone)
        if q:
            in_play += per_owner(layout, np.abs(energy))
        members = list(layout.junctions.values())
        created = _stack(n, [across(energy[:, m]) for m in members])
        exchanged = _stack(n, [0.5 * across(np.abs(energy[:, m])) for m in members])
    return Block(
        layout=layout,
        step=steps,
        t0=times,
        h=widths,
        H0=starts,
        H1=ends,
        dH=change,
        residual=residual,
        in_play=in_play,
        dissipated=lost,
        supplied=gained,
        moved=within,
        newton=_counts("newton", newton, (n, c)),
        substeps=_counts("substeps", substeps, (n, c)),
        port_energy=energy,
        port_u=_maybe("port_u", port_u, (n, q)),
        port_y=_maybe("port_y", port_y, (n, q)),
        junction_residual=created,
        junction_exchanged=exchanged,
        network=_balance(layout, ends, change, lost, damped, energy, created),
        numerical=damped,
    )


def per_owner(layout: Layout, energy: Floats) -> Floats:
    """Sum of port columns [n,q] for each component [n,c]."""
    with np.errstate(invalid="ignore", over="ignore"):
        sums = energy @ layout.owners
        if not np.isfinite(sums).all():  # 0 inf in the product is not a number, for components that have none of it
            sums = _stack(len(energy), [energy[:, column > 0.0].sum(axis=1) for column in layout.owners.T])
    return sums


def _balance(
    layout: Layout, H: Floats, dH: Floats, lost: Floats | None, damped: Floats | None, energy: Floats, created: Floats
) -> dict[str, Floats]:
    """Network columns: unexplained = (dH + dissipated + numerical - external) - junction residuals, each summed."""
    columns = {"H": across(H), "dH": across(dH)}
    balance = columns["dH"]
    with np.errstate(invalid="ignore", over="ignore"):
        for name, energies in (("dissipated", lost), ("numerical", damped)):
            if energies is not None:
                columns[name] = across(energies)
                balance = balance + columns[name]
        if layout.external:
            js, signs = zip(*layout.external, strict=True)
            columns["external"] = across(energy[:, list(js)] * np.array(signs))
            balance = balance - columns["external"]
        if layout.junctions:
            columns["junction_residual"] = across(created)
            balance = balance - columns["junction_residual"]
    columns["unexplained"] = balance
    return columns


def _table(name: str, x: ArrayLike, shape: tuple[int, ...]) -> Floats:
    array = np.array(x, np.float64, ndmin=1)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape} (steps, columns of the layout)")
    return array


def _maybe(name: str, x: ArrayLike | None, shape: tuple[int, ...]) -> Floats | None:
    return None if x is None else _table(name, x, shape)


def _counts(name: str, x: ArrayLike | None, shape: tuple[int, ...]) -> Ints | None:
    return None if x is None else _table(name, x, shape).astype(np.int64)


def _stack(n: int, columns: list[Floats]) -> Floats:
    return np.stack(columns, axis=1) if columns else np.zeros((n, 0))
