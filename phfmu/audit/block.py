"""Steps as the ledger takes them: what their columns are called, and what follows from them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from phfmu.engine.steps import Steps, balance

from .sums import Floats, Ints, across

# how well the energy of a component or port is known
EXACT = "exact"
ESTIMATED = "estimated"  # a quadrature, not the step's own
SILENT = "none"  # a unit that tells nothing
LOOSE = "loose"  # of junctions: members are coupled once a step, or an iteration was given up; their energy is told, not judged


@dataclass(frozen=True, slots=True)
class PortKey:
    """One effort/flow pair, one column of `Steps.pairs`; `index` numbers the pairs of a vector port from 1."""

    component: str
    port: str
    index: int | None = None
    junction: str | None = None
    quality: str = EXACT


@dataclass(frozen=True)
class Layout:
    """Names of the columns of `Steps`: c components, q scalar ports; the junctions follow from the ports.

    `silent`: components that tell nothing of their energy, neither by ports nor by books (foreign units).
    `loose`: the coupling does not claim that junctions create no energy.
    """

    components: tuple[str, ...]
    ports: tuple[PortKey, ...] = ()
    silent: frozenset[str] = frozenset()
    loose: bool = False

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


@dataclass(frozen=True, slots=True)
class Block:
    """n steps with what follows from them: [n] per step, [n,c] per component, [n,junctions] per junction; energies in joule.

    `in_play` is what a residual is measured against: the energies that moved within the component (`moved`, or else
    max(|H0|, |H1|)), |supplied|, |dissipated|, |numerical| and |energy| of each port pair. `network` holds the columns of
    the network's row, each [n]. Made by `make_block`.
    """

    layout: Layout
    step: Ints
    t0: Floats
    h: Floats
    H0: Floats
    steps: Steps
    residual: Floats
    in_play: Floats
    junction_residual: Floats
    junction_exchanged: Floats
    network: dict[str, Floats]
    relative: Floats | None = None  # filled in by who judges it


def make_block(
    layout: Layout, step: ArrayLike, t0: ArrayLike, h: ArrayLike, steps: Steps, H0: ArrayLike | None = None
) -> Block:
    """Copy n steps into a block and derive residuals, junctions and the network balance.

    Shapes: step (number), t0 [n], h [n] or scalar; H0 [n,c], at the starts of the steps; default H - stored.
    Errors: ValueError naming the array and both shapes.
    """
    numbers = np.array(step, np.int64, ndmin=1)
    n, c, q = len(numbers), len(layout.components), len(layout.ports)
    s = _checked(steps, n, c, q)
    with np.errstate(invalid="ignore", over="ignore"):
        starts = s.H - s.stored if H0 is None else _table("H0", H0, (n, c))
        gone = 0.0 if s.numerical is None else s.numerical
        inside = np.maximum(np.abs(starts), np.abs(s.H)) if s.moved is None else np.abs(s.moved)
        in_play = np.maximum(inside, np.abs(s.stored)) + np.abs(s.supplied) + np.abs(s.dissipated) + np.abs(gone)
        if q:
            in_play += per_owner(layout, np.abs(s.pairs))
        members = list(layout.junctions.values())
        created = _stack(n, [across(s.pairs[:, m]) for m in members])
        exchanged = _stack(n, [0.5 * across(np.abs(s.pairs[:, m])) for m in members])
        residual = balance(s.stored, s.dissipated, s.supplied, gone)
        return Block(
            layout, numbers, _table("t0", t0, (n,)), np.broadcast_to(np.array(h, float), (n,)), starts, s, residual,
            in_play, created, exchanged, _network(layout, s, created),
        )  # fmt: skip


def _checked(s: Steps, n: int, c: int, q: int) -> Steps:
    """A copy of the columns that are booked, of the right shapes."""
    shape = (n, c)
    return Steps(
        H=_table("H", s.H, shape),
        stored=_table("stored", s.stored, shape),
        dissipated=_table("dissipated", s.dissipated, shape),
        supplied=_table("supplied", s.supplied, shape),
        pairs=_table("pairs", s.pairs, (n, q)),
        numerical=_maybe("numerical", s.numerical, shape),
        moved=_maybe("moved", s.moved, shape),
        iterations=_maybe("iterations", s.iterations, (n,)),
        accepted_by=None if s.accepted_by is None else np.array(s.accepted_by),
    )


def per_owner(layout: Layout, energy: Floats) -> Floats:
    """Sum of port columns [n,q] for each component [n,c]."""
    with np.errstate(invalid="ignore", over="ignore"):
        sums = energy @ layout.owners
        if not np.isfinite(sums).all():  # 0 inf in the product is not a number, for components that have none of it
            sums = _stack(len(energy), [energy[:, column > 0.0].sum(axis=1) for column in layout.owners.T])
    return sums


def _network(layout: Layout, s: Steps, created: Floats) -> dict[str, Floats]:
    """Columns of the network: unexplained = balance of the sums, with the external supply, - junction residuals."""
    columns = {"H": across(s.H), "dH": across(s.stored), "dissipated": across(s.dissipated)}
    if s.numerical is not None:
        columns["numerical"] = across(s.numerical)
    if layout.external:
        js, signs = zip(*layout.external, strict=True)
        columns["external"] = across(s.pairs[:, list(js)] * np.array(signs))
    if layout.junctions:
        columns["junction_residual"] = across(created)
    none = np.zeros(len(s.H))
    left = balance(columns["dH"], columns["dissipated"], columns.get("external", none), columns.get("numerical", 0.0))
    columns["unexplained"] = left - columns.get("junction_residual", none)
    return columns


def _table(name: str, x: ArrayLike, shape: tuple[int, ...]) -> Floats:
    array = np.array(x, np.float64, ndmin=1)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape} (steps, columns of the layout)")
    return array


def _maybe(name: str, x: ArrayLike | None, shape: tuple[int, ...]) -> Floats | None:
    return None if x is None else _table(name, x, shape)


def _stack(n: int, columns: list[Floats]) -> Floats:
    return np.stack(columns, axis=1) if columns else np.zeros((n, 0))
