"""Columns of members stepped apart: those of the composed model, in its order, then what members add to them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from phfmu.declare.phdae import PHDAE
from phfmu.network.compose import wired
from phfmu.network.junction import End, junction_unknowns
from phfmu.network.network import Network
from phfmu.signals import LEDGER, MEAN, check_name, end_name, of_member, port_energy, total
from phfmu.terms.hidden import Level

Array = NDArray[np.float64]

#: of the ledger what instances tell; units alone tell the others
TOLD = [name for name, block, _ in LEDGER if block != "gap"]


class ColumnSection(IntEnum):
    """A section of the columns of a composed model, in their order; MORE: it has nothing of the kind."""

    FREE_PORT = 0
    FED_PORT = 1
    TOTAL = 2
    MEMBER_TOTAL = 3
    STATE = 4
    ALGEBRAIC = 5
    END = 6
    OBSERVABLE = 7
    MODE = 8
    VELOCITY = 9
    POSITION = 10
    MORE = 11


class WholeColumns:
    """Columns of the whole, by their `names`: those of `own`, rows of which are given, and their sums over all members."""

    def __init__(self, network: Network, members: Sequence[str], own: Sequence[str]):
        place = {n: i for i, n in enumerate(own)}
        rows = {total(what): [place.get(total(what, m)) for m in members] for what, _, _ in LEDGER}
        told = {n: [i for i in entries if i is not None] for n, entries in rows.items() if None not in entries}
        self.totals = list(told)
        self._places = np.array(list(told.values()), int).reshape(len(told), len(members))
        whole = network.gathered_from or network
        everything, at = [*told, *own], _places(whole)
        # a composed member's sums are of its own members
        kept = [*range(len(told)), *(i + len(told) for i, n in enumerate(own) if n not in rows)]
        member = {n: i for i, n in enumerate(whole.members)}

        def key(i: int) -> tuple[int, int, int]:
            n = everything[i]
            return at.get(n) or (ColumnSection.MORE, member.get(n.partition(".")[0], 0), 0)

        self._order = np.array(sorted(kept, key=key), int)
        self.names = [everything[i] for i in self._order]

    def rows(self, signals: Array) -> Array:
        """Rows of `own` (.. x columns) -> rows of `names`."""
        told = np.ascontiguousarray(signals[..., self._places])  # in the same order however many rows there are
        return np.concatenate([told.sum(axis=-1), signals], axis=-1)[..., self._order]


def _places(network: Network) -> dict[str, tuple[int, int, int]]:
    """Section, member and place in it of the columns of the composed model; a unit of another tool tells what it likes."""
    joined = {e for j in network.junctions for e in j.ends}
    at = {total(what): (int(ColumnSection.TOTAL), 0, i) for i, what in enumerate(TOLD)}
    fed = [w for w in network.wires if {w.source, w.target} <= network.declared.keys()]
    members = wired(network.declared, fed) if fed else network.declared
    for m, (name, declared) in enumerate(members.items()):
        for section, i, n in _of_declared(name, declared, joined):
            at[of_member(name, n)] = int(section), m, i
    last = len(network.members)
    for j in network.junctions:
        unknowns = junction_unknowns(network.members, j)
        for n in (n for v in (unknowns.common, *unknowns.dual.values()) for n in v.names()):
            i = len(at)
            at |= {n: (ColumnSection.ALGEBRAIC, last, i), end_name(n): (ColumnSection.END, last, i)}
            at[check_name(Level.VELOCITY, n)] = int(ColumnSection.VELOCITY), last, i
    return at


def _of_declared(name: str, declared: PHDAE, joined: set[End]) -> Iterator[tuple[ColumnSection, int, str]]:
    """Section, place in it and name of what a declared member tells."""
    for i, p in enumerate(declared.ports):
        free = p.external and End(name, p.name) not in joined
        for n in (*p.output_names(""), *p.output_names(MEAN), port_energy(p.name)):
            yield ColumnSection.FREE_PORT if free else ColumnSection.FED_PORT, i, n
    for i, owner in enumerate(declared.members):
        for what in TOLD:
            yield ColumnSection.MEMBER_TOTAL, i, total(what, owner)
    for v in declared.states:
        for n in v.names():
            yield ColumnSection.STATE, 0, n
    for n in (n for v in declared.algebraics for n in v.names()):
        yield ColumnSection.ALGEBRAIC, 0, n
        yield ColumnSection.END, 0, end_name(n)
        yield ColumnSection.VELOCITY, 0, check_name(Level.VELOCITY, n)
        yield ColumnSection.POSITION, 0, check_name(Level.POSITION, n)
    for o in declared.observables:
        for n in o.names():
            yield ColumnSection.OBSERVABLE, 0, n
    for n in declared.modes:
        yield ColumnSection.MODE, 0, n
