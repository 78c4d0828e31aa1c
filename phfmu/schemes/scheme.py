"""The interface of schemes to the step plan, and the parts that schemes with k nodes share."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from typing import Protocol

import numpy as np

from phfmu.gradients.quadrature import Nodes, nodes
from phfmu.plan.layout import Layout
from phfmu.plan.plan import Holds
from phfmu.plan.planner import SchemeMaps
from phfmu.plan.spec import Spec
from phfmu.plan.unknown import ALGEBRAIC, COSTATE, INCREMENT, Role, Unknown, of_algebraics, of_states
from phfmu.schemes.constraints.inertia import vanishing
from phfmu.terms.condense import CondensedVariables
from phfmu.terms.located import Row
from phfmu.terms.rank import ConstraintsAtStart
from phfmu.terms.term import Term, Terms

#: kinds of rows that are values; the others are equations, their left sides less these
VALUES = (Row.OUTPUT, Row.CONDENSED)

#: (row, Y index, value, power of h)
Triplet = tuple[int, int, float, int]


class Scheme(Protocol):
    """A one-step method: its unknowns, and the kernels of each kind of term."""

    @property
    def name(self) -> str:
        """The name of the scheme in options, as in `--scheme`."""
        ...

    @property
    def gradient(self) -> str:
        """The name of its discrete gradient in options, as in `--gradient`."""
        ...

    @property
    def order(self) -> int:
        """Order of the states."""
        ...

    @property
    def nodes(self) -> Nodes:
        """The nodes at which inputs are taken and outputs are averaged."""
        ...

    @property
    def joint(self) -> bool:
        """One gradient over all states of a member."""
        ...

    @property
    def loses_energy(self) -> bool:
        """True if the scheme has a numerical loss, which its ledger books."""
        ...

    @property
    def two_level(self) -> bool:
        """Holonomic constraints hold on the level of velocities too."""
        ...

    @property
    def node_values(self) -> bool:
        """A step keeps the order when an input has a value of its own at each node; else inputs are to be held."""
        ...

    @property
    def impulses(self) -> bool:
        """Bare nodes get impulses where their conditions hold."""
        ...

    def prepare(self, terms: Terms) -> Terms:
        """The terms to discretise; DeclarationError says what fits a model that this scheme does not."""
        ...

    def unknowns(self, terms: Terms) -> Sequence[Unknown]:
        """Every unknown; its row has the same number."""
        ...

    def reports(self, terms: Terms) -> Sequence[Hashable]:
        """Keys of the rows that are reported beside outputs."""
        ...

    def specs(self, term: Term) -> list[Spec]:
        """Kernels of one term; terms of equal key get the same."""
        ...

    def constants(self, layout: Layout) -> list[Triplet]:
        """Constant entries (row, Y index, value, power of h)."""
        ...

    def maps(self, layout: Layout) -> SchemeMaps:
        """Update of the states, means of the algebraic variables, start values of the next step."""
        ...

    def holds(self, layout: Layout) -> Holds:
        """Constraints whose rows may rest; none where the scheme cannot leave rows out."""
        ...


class GaussScheme:
    """Base of the schemes with k Gauss nodes; a scheme states where it differs."""

    k: int = 1
    gradient: str
    two_level: bool = False
    node_values: bool = False
    impulses: bool = False
    loses_energy: bool = False

    @property
    def joint(self) -> bool:
        return self.gradient == "joint-gonzalez"

    @property
    def order(self) -> int:
        return 1 if self.gradient == "itoh-abe" else 2 * self.k

    @property
    def nodes(self) -> Nodes:
        return nodes(self.k)

    def reports(self, terms: Terms) -> Sequence[Hashable]:
        del terms
        return ()

    def constants(self, layout: Layout) -> list[Triplet]:
        return node_constants(layout)

    def holds(self, layout: Layout) -> Holds:
        del layout
        return Holds()


def node_unknowns(terms: Terms, k: int, costates: Iterable[int] | None = None) -> list[Unknown]:
    """Increments, algebraic variables, and the costates of these states (None: those of blocks of E) at every node."""
    solved = terms.solved_costates() if costates is None else costates
    gone = set(terms.found(CondensedVariables).variables)
    left = [a for a in range(terms.na) if a not in gone]
    out: list[Unknown] = []
    for node in range(k):
        out += of_states(terms, INCREMENT, "balance of", range(terms.n1), node)
        out += of_states(terms, COSTATE, "costate of", solved, node)
        out += of_algebraics(terms, ALGEBRAIC, "equation of", left, node)
    return out


def node_constants(layout: Layout, costates: Iterable[int] | None = None) -> list[Triplet]:
    """Identity rows of E, E^T z = W rows, and the constant entries of (J - R) z + B u at every node.

    `costates`: of the states with such rows (None: those of blocks of E).
    """
    terms, out = layout.terms, []
    other = terms.with_descriptor()
    solved = terms.solved_costates() if costates is None else costates
    for node in range(layout.k):
        for i in range(terms.n1):
            if i not in other:
                w = layout.at(INCREMENT, i, node)
                out.append((w, w, 1.0, 0))
        for i in solved:
            out.append((layout.at(COSTATE, i, node), layout.nv + layout.slot(i, node), -1.0, 0))
        for c in terms.constants:
            value = c.value if c.row.kind in VALUES else -c.value
            out.append((layout.row(c.row, node), layout.value(c.source, node), value, int(c.row.kind is Row.BALANCE)))
    return out


def node_maps(layout: Layout, nd: Nodes, *, even: bool = False) -> SchemeMaps:
    """x' = x + sum b_i D_i, means sum b_i a_i, and the last step's polynomial extrapolated; other unknowns start as they were.

    `even`: a step starts with the means of the last one at all of its nodes instead.  The polynomial through k = 3 nodes
    has grown 60 times at the end of the next step: of an oscillation that is faster than the steps nothing else is left.
    """
    update, mean, guess = [], [], []
    for node in range(layout.k):
        values = ((a, layout.nv + layout.condensed_slot(a, node)) for a in layout.condensed)
        mean += [(a, at, float(nd.b[node]), 0) for a, at in values]
    ahead = np.array([nd.b if even else nd.value(1.0 + c) for c in nd.c])
    for w, u in enumerate(layout.unknowns):
        if u.role is INCREMENT:
            update.append((u.index, w, float(nd.b[u.node])))
        elif u.role is ALGEBRAIC:
            mean.append((u.index, w, float(nd.b[u.node]), 0))
        elif u.role is not COSTATE:
            guess.append([(w, 1.0, 0)])
            continue
        last = [layout.at(u.role, u.index, j) for j in range(layout.k)]
        guess.append([(last[j], float(ahead[u.node, j]), int(u.role is INCREMENT)) for j in range(layout.k)])
    return SchemeMaps(update, mean, guess, nd.b, nd.c)


def node_holds(layout: Layout, *levels: Role) -> Holds:
    """The constraints of a model with their rows at the nodes, and those of further levels."""
    found = layout.terms.found(ConstraintsAtStart)
    rows = [
        (*(layout.at(ALGEBRAIC, a, i) for i in range(layout.k)), *(layout.at(level, a) for level in levels))
        for a in found.sizes
    ]
    rests = np.array([a in found.resting for a in found.sizes], bool)
    return Holds(tuple(rows), rests, np.array(list(found.sizes.values())), vanishing(layout.terms))
