"""Addresses of a scheme's unknowns, rows and assembled values in the plan's spaces."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from phfmu.discretise.spec import Address
from phfmu.discretise.terms import Term, Terms

#: unknowns that are numbered by states; all others by algebraic variables
STATE_KINDS = ("D", "Z", "s0", "s1", "mu.D", "mu.Z")
#: terms whose kernels read the old algebraic variables after the old states
CARRYING = ("closure", "given", "nearness")


@dataclass
class Layout:
    """Where (kind, index, node) lives.

    `unknowns`: list of (kind, global index, node), giving w; the row of an unknown has the same number:
    D <-> balance of that state, a <-> row of that algebraic variable, Z <-> E^T z = W, m <-> velocity constraint,
    b (rate of an algebraic variable) <-> the undifferentiated row that gives it, i0 and i1 (impulse, roots) <-> end
    current and square root at a bare node, s0 and s1 <-> shifts of a state by the impulses, X (carried algebraic
    variable) <-> its closure, mu.* (multiplier of an equation) <-> stationarity of that equation's own unknown.
    """

    terms: Terms
    k: int
    unknowns: list[tuple[str, int, int]]
    costate_rate: bool = False
    #: instant plans: (algebraic row, 0 velocity | 1 position) -> observable row of a hidden constraint
    checks: dict[tuple[int, int], int] = field(default_factory=dict)
    #: instant plans: differentiated algebraic row -> the algebraic variable its undifferentiated form gives
    solved_by: dict[int, int] = field(default_factory=dict)
    w_of: dict[tuple[str, int, int], int] = field(init=False)
    #: (row, component) -> row of R with the work of an impulse
    work: dict[tuple[int, int], int] = field(init=False)

    def __post_init__(self) -> None:
        self.w_of = {u: i for i, u in enumerate(self.unknowns)}
        self.sources = [i for i, p in enumerate(self.terms.pairs) if p.port.source is not None]
        self.source_slot = {p: j for j, p in enumerate(self.sources)}
        self.bound = self.terms.bound
        first = self.nw + len(self.terms.pairs) * self.k
        impulses = [(i, t.owner) for t in self.terms.terms if t.kind == "impulse" for kind, i in t.rows if kind == "a"]
        self.work = {key: first + n for n, key in enumerate(impulses)}

    @property
    def nw(self) -> int:
        return len(self.unknowns)

    @property
    def nv(self) -> int:
        return self.nw + self.terms.nu * self.k + 1

    @property
    def nz(self) -> int:
        n1 = self.terms.n1 * (2 if self.costate_rate else 1)
        return (n1 + len(self.sources) * (2 if self.costate_rate else 1)) * self.k

    def slot(self, i: int, node: int) -> int:
        """Z index of the costate (or gradient) of state i at a node."""
        return node * self.terms.n1 + i

    def rate_slot(self, i: int) -> int:
        """Z index of dz/dt of state i (instant plans)."""
        return self.terms.n1 * self.k + i

    def source_index(self, pair: int, node: int) -> int:
        base = self.terms.n1 * self.k * (2 if self.costate_rate else 1)
        return base + node * len(self.sources) + self.source_slot[pair]

    def value(self, kind: str, i: int, node: int) -> int:
        """Y index of a value by global index."""
        if kind == "z":
            w = self.w_of.get(("Z", i, node))
            return self.nv + self.slot(i, node) if w is None else w
        if kind == "Q":
            return self.nv + self.rate_slot(i)
        if kind == "u":
            return self.input_index(i, node)
        if kind == "h":
            return self.nv - 1
        return self.w_of[(kind, i, node)]

    def input_index(self, pair: int, node: int) -> int:
        """Y index of the input value of a pair: external input, source value or bound algebraic variable."""
        if pair < self.terms.nu:
            return self.nw + node * self.terms.nu + pair
        if pair in self.source_slot:
            return self.nv + self.source_index(pair, node)
        return self.w_of[("a", self.bound[pair], node)]

    def argument(self, term: Term, address: Address) -> int:
        """Y index of a kernel argument."""
        kind, j, node = address
        if kind in ("D", "r", "q"):
            source = term.index["x"][j]
            return self.value({"D": "D", "r": "D", "q": "Q"}[kind], source, node)
        if kind == "v":  # velocity costate that belongs to position j of a constraint
            return self.value("z", self._velocity(term, j), node)
        if kind == "V":  # increment (or rate) of that velocity
            return self.value("D", self._velocity(term, j), node)
        if kind == "Q":
            return self.value("Q", self._velocity(term, j), node)
        if kind == "Z":  # costate of the term's own state
            return self.value("z", term.index["x"][j], node)
        if kind == "l":
            return self.value("a", term.rows[0][1], node)
        if kind == "m":
            return self.value("m", term.rows[0][1], 0)
        if kind == "h":
            return self.value("h", 0, 0)
        if kind == "s0" and term.kind != "impulse":
            return self.value("s0", term.index["x"][j], 0)
        if kind in ("s0", "s1", "i0", "i1"):
            return self.value(kind, term.rows[j][1], node)
        if kind == "da":
            return self.value("b", term.index["a"][j], node)
        if kind == "du":
            return self.value("b", self.bound[term.index["u"][j]], node)
        if kind == "dz":
            return self.value("Q", term.index["z"][j], node)
        if kind == "X":
            return self.value("X", term.index["a"][j], node)
        if kind.startswith("mu."):
            return self.multiplier(self.result(term, (kind[3:], j, node)))
        return self.value(kind, term.index[kind][j], node)

    def _velocity(self, term: Term, j: int) -> int:
        return self.terms.velocity_of[term.index["x"][j]]

    def old(self, term: Term, spec_nx: int) -> list[int]:
        """x indices of a kernel's old values: its states, for constraints of schemes that ask also velocities, time."""
        base = list(term.index.get("x", ()))
        if term.kind == "constraint" and spec_nx - ("t" in term.index) == 2 * len(base):
            base += [self._velocity(term, j) for j in range(len(base))]
        if "t" in term.index:
            base.append(self.terms.n1)
        if term.kind in CARRYING:
            base += [self.terms.n1 + 1 + i for i in term.index["a"]]
        return base[:spec_nx] if spec_nx else []

    def result(self, term: Term, address: Address) -> int:
        """Z index (stage 0) or row index (stage 1) of a kernel result."""
        kind, j, node = address
        if kind == "W":
            return self.slot(term.rows[j][1], node)
        if kind == "Q":
            return self.rate_slot(term.rows[j][1])
        if kind == "S":
            return self.source_index(term.rows[0][1], node)
        if kind == "shift":
            return self.slot(self._velocity(term, j), node)
        if kind == "velocity":
            return self.w_of[("D", self._velocity(term, j), node)]
        if kind == "light":
            return self.w_of[("Z", self._velocity(term, j), node)]
        if kind == "m":
            return self.w_of[("m", term.rows[0][1], 0)]
        if kind == "original":
            return self.w_of[("b", self.solved_by[term.rows[j][1]], 0)]
        if kind == "SR":
            return self.source_index(term.rows[0][1], 0) + len(self.sources)
        if kind == "check":
            return self.row("o", self.checks[(term.rows[j][1], node)], 0)
        if kind in ("s0", "s1", "i0", "i1"):
            return self.w_of[(kind, term.rows[j][1], node)]
        if kind == "work":
            return self.work[(term.rows[j][1], term.owner)]
        if kind.startswith("stat."):
            return self.stationary(self.argument(term, (kind[5:], j, node)))
        if kind == "costate":
            return self.w_of[("Z", term.rows[j][1], node)]
        row_kind, i = term.rows[j]
        return self.row(row_kind, i, node)

    def row(self, kind: str, i: int, node: int) -> int:
        """Row index of a state balance, an algebraic row, a pair output or an observable."""
        nq = len(self.terms.pairs)
        if kind == "y":
            return self.nw + node * nq + i
        if kind == "o":
            return self.nw + nq * self.k + i
        return self.w_of[({"x": "D"}.get(kind, kind), i, node)]

    def multiplier(self, row: int) -> int:
        """Unknown that multiplies an equation, where the scheme minimises."""
        kind, i, node = self.unknowns[row]
        return self.w_of[(f"mu.{kind}", i, node)]

    def stationary(self, w: int) -> int:
        """Row that says the minimum does not change with unknown `w`: that of its multiplier, else its own."""
        kind, i, node = self.unknowns[w]
        return self.w_of.get((f"mu.{kind}", i, node), w)

    def names(self) -> list[str]:
        """A name per unknown/row for messages."""
        states = [n for v in self.terms.model.states for n in v.names()]
        algebraics = [n for v in self.terms.model.algebraics for n in v.names()]
        text = {
            "D": lambda i: f"balance of {states[i]}",
            "a": lambda i: f"equation of {algebraics[i]}",
            "Z": lambda i: f"costate of {states[i]}",
            "m": lambda i: f"velocity constraint of {algebraics[i]}",
            "b": lambda i: f"rate of {algebraics[i]}",
            "i0": lambda i: f"end current at {algebraics[i]}",
            "i1": lambda i: f"impulse at {algebraics[i]}",
            "s0": lambda i: f"start impulse on {states[i]}",
            "s1": lambda i: f"end impulse on {states[i]}",
            "X": lambda i: f"closure of {algebraics[i]}",
        }
        text |= {f"mu.{kind}": lambda i, own=text[kind]: f"least distance, {own(i)}" for kind in "DZa"}  # fmt: skip
        suffix = (lambda node: f" (node {node + 1})") if self.k > 1 else (lambda node: "")
        return [text[kind](i) + suffix(node) for kind, i, node in self.unknowns]

    def unknown_names(self) -> list[str]:
        """The variable each unknown stands for, for messages."""
        states = [n for v in self.terms.model.states for n in v.names()]
        algebraics = [n for v in self.terms.model.algebraics for n in v.names()]
        return [(states if kind in STATE_KINDS else algebraics)[i] for kind, i, _ in self.unknowns]

    def nominals(self) -> np.ndarray:
        x = [v.nominal[j] for v in self.terms.model.states for j in range(v.n)]
        a = [v.nominal[j] for v in self.terms.model.algebraics for j in range(v.n)]
        found = self.terms.impulses
        impulse = max(x[i] for i in found.end_states) if found else 1.0  # it has the unit of the states it shifts
        size = dict.fromkeys(STATE_KINDS, x) | {"i0": [impulse] * len(a), "i1": [impulse] * len(a)}
        return np.array([size.get(kind, a)[i] for kind, i, _ in self.unknowns], float).reshape(-1)
