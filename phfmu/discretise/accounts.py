"""Accounts within components: each energy and each resistor of a declaration booked by itself, for audits that ask for it.

An engine books energies by the members of its model.  In the declaration that `by_term` gives every term of H and every part of R
has a member of its own beside the component's, so that engines book it as they book any; a run folds the accounts of a
component back into one.  Nothing of it is in a declaration, or a compiled model, that was not asked for.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.block import Block
from phfmu.declare.phdae import ACCOUNT, PHDAE
from phfmu.declare.port import Port
from phfmu.terms.canonical import components
from phfmu.words import folded

Array = NDArray[Any]


@dataclass(frozen=True)
class Account:
    """A term of a component, whose change (H) or loss (R) is the entry `place` among the members of the model."""

    component: str
    term: str
    place: int

    @property
    def stores(self) -> bool:
        return self.term.startswith("H(")


@dataclass(frozen=True)
class Accounts:
    """Members of a model that are components, each followed by its accounts; `terms`: all of these."""

    first: tuple[int, ...]
    terms: tuple[Account, ...]

    @staticmethod
    def of(members: Iterable[str]) -> Accounts | None:
        """The accounts among these members, None if no term has one."""
        names = list(members)
        first = tuple(i for i, name in enumerate(names) if ACCOUNT not in name)
        if len(first) == len(names):
            return None
        divided = ((i, *name.split(ACCOUNT, 1)) for i, name in enumerate(names) if ACCOUNT in name)
        return Accounts(first, tuple(Account(component, term, i) for i, component, term in divided))

    def folded(self, values: Array) -> Array:
        """Values of members (.. x members) added up by component (.. x components)."""
        return np.add.reduceat(values, list(self.first), axis=-1)

    def by_term(self, stored: Array, dissipated: Array) -> Array:
        """Energy that each term stored, or lost (n x terms), from that of the members (n x members)."""
        return np.stack([(stored if a.stores else dissipated)[:, a.place] for a in self.terms], axis=1)


def by_term(declaration: PHDAE) -> PHDAE:
    """The model with an account for each energy and each part of R.

    H(p), H(q[1..3]) by the states of an energy, R(Ra) by the parameters of a part of R or, without any, the variables it
    acts on; what has one name in a component is one account.
    """
    d = declaration
    found: dict[str, dict[str, None]] = {owner: {} for owner in d.members}

    def account(owner: str, term: str) -> str:
        known = owner if owner in found else d.members[0]
        name = f"{known}{ACCOUNT}{term}"
        found[known][name] = None
        return name

    states = _names((n, s) for v in d.states for n, s in zip(v.names(), ca.vertsplit(v.sx), strict=True))
    parameters = _names((n, s) for v in d.parameters for n, s in zip(v.names(), ca.vertsplit(v.sx), strict=True))

    def named(what: str, owner: str, names: Iterable[str]) -> str:
        own = f"{owner}."
        return account(owner, f"{what}({folded([n.removeprefix(own) for n in names])})")

    energies = tuple(replace(e, owner=named("H", e.owner, _among(e.expr, states))) for e in d.energies)
    pairs = tuple(replace(p, owner=named("H", p.owner, _among(p.hamiltonian, states))) for p in d.closed)
    parts = [part for b in d.dissipation for part in _parts(b, parameters)]
    losses = tuple(replace(b, owner=named("R", b.owner, names)) for b, names in parts)
    members = tuple(name for owner, own in found.items() for name in (owner, *own))
    return replace(d, energies=energies, closed=pairs, dissipation=losses, members=members)


def _names(symbols: Iterable[tuple[str, ca.SX]]) -> dict[int, str]:
    return {s.element_hash(): name for name, s in symbols}


def _among(expr: ca.SX, names: dict[int, str]) -> list[str]:
    """Names whose symbols an expression has, in their order."""
    there = {s.element_hash() for s in ca.symvar(expr)}
    return [name for key, name in names.items() if key in there] or ["constant"]


def _parts(b: Block, parameters: dict[int, str]) -> list[tuple[Block, list[str]]]:
    """A block of R in blocks that share no row, with the names by which each is told."""
    rows = [name for v in b.variables for name in (v.input_names() if isinstance(v, Port) else v.names())]
    b = b.changed(ca.sparsify)
    by_names: dict[tuple[str, ...], list[int]] = {}
    for part in components(b.pattern):
        own = _among(ca.veccat(*b.on(part).parts), parameters)
        names = [rows[i] for i in part] if own == ["constant"] else own
        by_names.setdefault(tuple(names), []).extend(part)
    return [(b.on(part), list(names)) for names, part in by_names.items()]
