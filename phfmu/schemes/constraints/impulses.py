"""Neutral impulse pairs at bare nodes: Kirchhoff's law at the step ends, exact balance, order 2k.

A bare node joins inductive branches only: its row c(x) = sum of currents = 0 contains no algebraic variable (index 2).
Collocation makes c vanish at the Gauss nodes, not at the step ends.  With x' = L(x) v + ... from the node voltages v,
c = -L^T grad H, S = L^T H'' L and sigma = (-1)^k, a voltage impulse m at the start and one at the end of the step,

    x0* = x0 + L(x0) m,   collocation from x0* to x1*,   x1 = x1* + L(x1*) m',   c(x1) = 0,   m' = sigma T m,

with T = (S1^-1 S0)^(1/2), leave the energy alone: 1/2 m^T S0 m enters at the start and 1/2 m'^T S1 m' = 1/2 m^T S0 m
leaves at the end.  T m is the n-point midpoint rule of  A^(1/2) = 2/pi int_0^(pi/2) A (cos^2 + A sin^2)^-1,

    (cos^2 t_l S1 + sin^2 t_l S0) r_l = S0 m,   m' = sigma/n sum r_l,   t_l = (2 l - 1) pi / (4 n),

whose relative error ((1 - sqrt a)/(1 + sqrt a))^(2 n) is below rounding for the change a of S over a step; every row is
a sum over members.  docs/proofs/bare-nodes.md has the proofs.  Needs (dL/dx) L = 0 and (dS/dx) L = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from phfmu.declare.variable import ValueKind
from phfmu.gradients.quadrature import Nodes, gauss
from phfmu.plan.address import Address, Place, increment
from phfmu.plan.layout import Layout
from phfmu.plan.planner import SchemeMaps
from phfmu.plan.spec import Arguments, Result, Spec
from phfmu.plan.unknown import Role, Unknown, of_algebraics, of_states
from phfmu.terms.bare import IMPULSE, BareRows, Remedy
from phfmu.terms.located import Row
from phfmu.terms.term import Term, Terms

#: Points of the rule for the square root: error (e/4)^(2 POINTS) for a relative change e of S over a step.
POINTS = 3
#: Gauss points of the work of a projecting impulse.
WORK_POINTS = 5

#: the impulse m at the start;  the roots r_l, whose sum is the impulse at the end, or that impulse;  the shifts L m, L m'
START, ROOT = Role("start impulse", vanishes=True), Role("end impulse", vanishes=True)
START_SHIFT, END_SHIFT = Role("start shift", vanishes=True), Role("end shift", vanishes=True)


@dataclass(frozen=True)
class Impulses:
    """Rows of bare nodes with an impulse pair and with a projecting end impulse; the states shifted at start and end."""

    pairs: tuple[int, ...] = ()
    projected: tuple[int, ...] = ()
    start_states: tuple[int, ...] = ()
    end_states: tuple[int, ...] = ()


@dataclass(frozen=True)
class Work:
    """Reported: the work of the impulses of a bare row on a member."""

    row: int
    owner: int


def _place(role: Role) -> Place:
    """The unknown of the term's j-th row."""

    def place(layout: Layout, term: Term, j: int, node: int) -> int:
        return layout.at(role, term.rows[j].index, node)

    return place


start, root, start_shift, end_shift = map(_place, (START, ROOT, START_SHIFT, END_SHIFT))


def own_start_shift(layout: Layout, term: Term, j: int, node: int) -> int:
    """The shift at the start of the j-th state that a term reads."""
    return layout.at(START_SHIFT, term.index[ValueKind.STATE][j], node)


def work_on(layout: Layout, term: Term, j: int, node: int) -> int:
    """The work of the term's j-th row on its member."""
    del node
    return layout.report(Work(term.rows[j].index, term.owner))


def prepare(terms: Terms) -> Terms:
    """Terms with the impulses of their bare nodes; the same object where there are none."""
    bare = BareRows(terms)
    pairs, ends = bare.impulse_terms(Remedy.PAIR), bare.impulse_terms(Remedy.PROJECTION)
    if not pairs and not ends:
        return terms
    shifted, ended = _states(pairs), _states(pairs + ends)
    rows = {remedy: tuple(n.row for n in bare.nodes if n.remedy == remedy) for remedy in Remedy}
    marked = [_marked(t, set(shifted)) for t in terms.terms]
    impulses = Impulses(rows[Remedy.PAIR], rows[Remedy.PROJECTION], shifted, ended)
    return replace(terms, terms=marked + pairs + ends).having(impulses)


def _states(terms: list[Term]) -> tuple[int, ...]:
    return tuple(sorted({r.index for t in terms for r in t.rows if r.kind is Row.BALANCE}))


def _marked(t: Term, shifted: set[int]) -> Term:
    """A term with the local places of shifted states as data; they are part of its key."""
    where = tuple(j for j, i in enumerate(t.indices(ValueKind.STATE)) if i in shifted)
    return replace(t, key=(*t.key, ("shifted", where)), data=t.data | {"shifted": where}) if where else t


def shifted(spec: Spec, term: Term) -> Spec:
    """A kernel of `term` that starts from x0*: its shifted old states are x + s."""
    where = term.data.get("shifted", ())
    if not where or not spec.x.numel():
        return spec
    symbols = [ca.SX.sym(f"s{j}") for j in where]
    x = ca.SX(spec.x)
    for j, s in zip(where, symbols, strict=True):
        x[j] += s

    def moved(e: ca.SX | None) -> ca.SX | None:
        return None if e is None else ca.substitute(e, spec.x, x)

    y = spec.y + [(Address(own_start_shift, j), s) for j, s in zip(where, symbols, strict=True)]
    out = [(a, power, ca.substitute(e, spec.x, x)) for a, power, e in spec.out]
    return replace(spec, y=y, out=out, stored=moved(spec.stored), lost=moved(spec.lost))


def specs(term: Term, nd: Nodes) -> list[Spec]:
    """Rows of the impulses and shifts, and their work."""
    return _pair(_Member(term, nd)) if term.form is Remedy.PAIR else _projection(_Member(term, nd))


class _Member:
    """The part of a member in the rows of its bare nodes: psi (shifted states, the first of its `x`) and node rows."""

    def __init__(self, term: Term, nd: Nodes):
        self.args, self.data, self.k = Arguments(term, nd.k), term.data, nd.k
        self.x, n = term.local[ValueKind.STATE], term.local[ValueKind.STATE].numel()
        self.psi = range(sum(r.kind is Row.BALANCE for r in term.rows))
        self.nodes = range(len(self.psi), len(term.rows))
        self.rest = ca.SX(n - len(self.psi), 1)
        self.increment = ca.mtimes(self.args.matrix(increment, n), ca.DM(nd.b))

    def column(self, place: Place, places: range, i: int = 0) -> ca.SX:
        return ca.vertcat(*(self.args.symbol(place, j, i) for j in places))

    def shifted(self, x: ca.SX, shift: ca.SX) -> ca.SX:
        return x + ca.vertcat(shift, self.rest)

    def at(self, name: str, x: ca.SX) -> ca.SX:
        """L, S or c at a state."""
        return ca.substitute(self.data[name], self.x, x)

    def rows(self, place: Place, places: range, value: ca.SX, i: int = 0) -> list[Result]:
        return [(Address(place, j, i), 0, value[n]) for n, j in enumerate(places)]

    def specs(self, out: list[Result], work: ca.SX) -> list[Spec]:
        """The rows `out`, and the report of the work (one value per node) that impulses do on the member."""
        args = self.args
        return [
            Spec(1, args.x, args.p, args.y, out),
            Spec(1, args.x, args.p, args.y, self.rows(work_on, self.nodes, work), stored=ca.sum1(work), report=True),
        ]


def _pair(own: _Member) -> list[Spec]:
    s0, s1 = own.column(start_shift, own.psi), own.column(end_shift, own.psi)
    m = own.column(start, own.nodes)
    roots = [own.column(root, own.nodes, i) for i in range(POINTS)]
    end = sum(roots[1:], roots[0]) * ((-1.0) ** own.k / POINTS)
    x_start = own.shifted(own.x, s0)
    x_end = x_start + own.increment
    x_new = own.shifted(x_end, s1)
    S0, S1 = own.at("S", own.x), own.at("S", x_end)
    out = own.rows(start_shift, own.psi, s0 - ca.mtimes(own.at("L", own.x), m))
    out += own.rows(end_shift, own.psi, s1 - ca.mtimes(own.at("L", x_end), end))
    for i, r in enumerate(roots):
        angle = (2 * i + 1) * np.pi / (4 * POINTS)
        mixed = np.cos(angle) ** 2 * ca.mtimes(S1, r) + np.sin(angle) ** 2 * ca.mtimes(S0, r)
        out += own.rows(root, own.nodes, mixed - ca.mtimes(S0, m), i)
    c = [own.at("c", v) for v in (own.x, x_start, x_end, x_new)]
    out += own.rows(start, own.nodes, c[3])
    work = -(m * (c[0] + c[1]) + end * (c[2] + c[3])) / 2  # y = -c; exact, as H is quadratic along L
    return own.specs(out, work)


def _projection(own: _Member) -> list[Spec]:
    """One impulse at the end: x1 = x1* + L m, c(x1) = 0; its work is the path integral of -c along L m, a loss."""
    s, m = own.column(end_shift, own.psi), own.column(root, own.nodes)
    x_end = own.x + own.increment

    def c(part: float) -> ca.SX:
        return own.at("c", own.shifted(x_end, part * s))

    out = own.rows(end_shift, own.psi, s - ca.mtimes(own.at("L", x_end), m)) + own.rows(root, own.nodes, c(1.0))
    parts = [float(w) * c(float(t)) for t, w in zip(*gauss(WORK_POINTS), strict=True)]
    return own.specs(out, -m * sum(parts[1:], parts[0]))


def unknowns(terms: Terms) -> list[Unknown]:
    """Impulses and roots per bare row, shifts per shifted state."""
    found = terms.found(Impulses)
    if not found.end_states:
        return []
    size = max(terms.state_nominals[i] for i in found.end_states)  # it has the unit of the states it shifts
    out = of_algebraics(terms, START, "end current at", found.pairs, nominal=size)
    for r in found.pairs:
        for i in range(POINTS):
            out += of_algebraics(terms, ROOT, "impulse at", [r], i, nominal=size)
    out += of_algebraics(terms, ROOT, "impulse at", found.projected, nominal=size)
    out += of_states(terms, START_SHIFT, "start impulse on", found.start_states)
    return out + of_states(terms, END_SHIFT, "end impulse on", found.end_states)


def reports(terms: Terms) -> list[Work]:
    """The work of every impulse on every member."""
    return [Work(r.index, t.owner) for t in terms.of(IMPULSE) for r in t.rows if r.kind is Row.EQUATION]


def maps(layout: Layout, base: SchemeMaps) -> SchemeMaps:
    """`base` with the shifts of x', with node voltages whose interval means include the impulses, (m + m')/h, and with work."""
    found = layout.terms.found(Impulses)
    if not found.end_states:
        return base
    end = (-1.0) ** layout.k / POINTS
    factor = {(START, r): 1.0 for r in found.pairs} | {(ROOT, r): end for r in found.pairs}
    factor |= {(ROOT, r): 1.0 for r in found.projected}
    at = list(enumerate(layout.unknowns))
    return replace(
        base,
        update=base.update + [(u.index, w, 1.0) for w, u in at if u.role in (START_SHIFT, END_SHIFT)],
        mean=base.mean + [(u.index, w, factor[u.role, u.index], -1) for w, u in at if (u.role, u.index) in factor],
        work=_work(layout),
        jumps=[(u.index, w) for w, u in at if u.role is START_SHIFT],
    )


def _work(layout: Layout) -> list[tuple[int, int]]:
    """(pair, row of R) of the energy that impulses carry through a port of a composed network."""
    terms = layout.terms
    pairs = {(terms.bound[i], p.owner): i for i, p in reversed(list(enumerate(terms.pairs))) if i in terms.bound}
    found = ((pairs.get((work.row, terms.component(work.owner))), work) for work in reports(terms))
    return [(pair, layout.report(work)) for pair, work in found if pair is not None]
