"""Neutral impulse pairs at bare nodes: Kirchhoff's law at the step ends, exact balance, order 2k.

A bare node joins inductive branches only: its row c(x) = sum of currents = 0 contains no algebraic variable (index 2).
Collocation makes c vanish at the Gauss nodes, not at the step ends.  With x' = L(x) v + ... from the node voltages v,
c = -L^T grad H, S = L^T H'' L and sigma = (-1)^k, a voltage impulse m at the start and one at the end of the step,

    x0* = x0 + L(x0) m,   collocation from x0* to x1*,   x1 = x1* + L(x1*) m',   c(x1) = 0,   m' = sigma T m,

with T = (S1^-1 S0)^(1/2), leave the energy alone: 1/2 m^T S0 m enters at the start and 1/2 m'^T S1 m' = 1/2 m^T S0 m
leaves at the end.  T m is the n-point midpoint rule of  A^(1/2) = 2/pi int_0^(pi/2) A (cos^2 + A sin^2)^-1,

    (cos^2 t_l S1 + sin^2 t_l S0) r_l = S0 m,   m' = sigma/n sum r_l,   t_l = (2 l - 1) pi / (4 n),

whose relative error ((1 - sqrt a)/(1 + sqrt a))^(2 n) is below rounding for the change a of S over a step; every row is
a sum over members.  docs/concepts/bare-nodes.md has the proofs.  Needs (dL/dx) L = 0 and (dS/dx) L = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from phfmu.discretise.arguments import Arguments
from phfmu.discretise.hidden import hidden_rows
from phfmu.discretise.layout import Layout
from phfmu.discretise.quadrature import Nodes
from phfmu.discretise.rows import costate_symbols, row_expressions
from phfmu.discretise.spec import Address, Spec
from phfmu.discretise.terms import Locator, Term, Terms, components, make_term

#: Points of the rule for the square root: error (e/4)^(2 POINTS) for a relative change e of S over a step.
POINTS = 3


@dataclass(frozen=True)
class BareNode:
    """A bare algebraic row and what is done about it; `reason` is empty where impulses apply, else says why not."""

    row: int
    name: str
    reason: str = ""


def bare_nodes(terms: Terms) -> list[BareNode]:
    """Rows of nodes that join inductive branches only and whose currents depend on the state nonlinearly.

    A row that is linear in the state (constant L, quadratic H) stays at its start value and needs nothing.
    """
    return _Finder(terms).nodes


def prepare(terms: Terms) -> Terms:
    """Terms with the impulses of their bare nodes; the same object where there are none."""
    finder = _Finder(terms)
    rows = [n.row for n in finder.nodes if not n.reason]
    if not rows:
        return terms
    new = finder.impulse_terms(rows)
    shifted = {i for t in new for kind, i in t.rows if kind == "x"}
    return replace(terms, terms=[_marked(t, shifted) for t in terms.terms] + new, shifted=tuple(sorted(shifted)),
                   impulse_rows=tuple(rows))  # fmt: skip


class _Finder:
    """Symbolic form of the bare rows of a model."""

    def __init__(self, terms: Terms):
        self.terms, self.nodes = terms, []
        hidden = hidden_rows(terms)
        holonomic = {t.rows[0][1] for t in terms.terms if t.kind == "constraint"}
        rows = [r for r in hidden.checks if r not in holonomic]
        if not rows:
            return
        model = terms.model
        self.x, self.z = model.x, costate_symbols(model)
        self.expr = row_expressions(terms, rows, self.z)
        self.L = {r: -ca.jacobian(self.expr[r], self.z) for r in rows}
        self.owner = _state_owners(terms)
        names = [n for v in model.algebraics for n in v.names()]
        self.hessian, gradient = ca.hessian(model.hamiltonian, self.x)
        linear = {r for r in rows if self._linear(r, gradient)}
        for cluster in self._clusters(rows):
            if not linear.issuperset(cluster):
                reason = self._refusal(cluster, names)
                self.nodes += [BareNode(r, names[r], reason) for r in cluster]

    def _states(self, r: int) -> set[int]:
        return set(self.L[r].sparsity().get_triplet()[1])

    def _clusters(self, rows: list[int]) -> list[list[int]]:
        """Rows that S = L^T H'' L couples: they share branches or mutual inductances."""
        L = ca.vertcat(*(self.L[r] for r in rows))
        pattern = ca.mtimes([L, self.hessian, L.T]) + ca.SX.eye(len(rows))
        return [[rows[i] for i in part] for part in components(pattern)]

    def _linear(self, r: int, gradient: ca.SX) -> bool:
        c = ca.mtimes(self.L[r], gradient)
        return not ca.depends_on(ca.simplify(ca.jacobian(c, self.x)), self.x)

    def _refusal(self, cluster: list[int], names: list[str]) -> str:
        """Why impulses do not fit these rows, or nothing."""
        terms, states = self.terms, sorted(set().union(*(self._states(r) for r in cluster)))
        state_names = [n for v in terms.model.states for n in v.names()]
        special = {i: t.kind for t in terms.terms if t.kind in ("mass", "massblock", "closed") for _, i in t.rows}
        for i in states:
            if i in special:
                return f"the row of {state_names[i]} has E other than identity"
            if i not in self.owner:
                return f"{state_names[i]} stores no energy"
        psi = ca.vertcat(*(self.x[i] for i in states))
        for r in cluster:
            if ca.depends_on(self.expr[r], terms_algebraics(terms)) or ca.depends_on(self.L[r], self.z):
                return f"the row of {names[r]} contains other algebraic variables"
            if _depends(self.L[r], psi):
                return f"the coefficients of {names[r]} depend on the states they act on"
        L = ca.vertcat(*(self.L[r][0, states] for r in cluster))
        hessian = ca.hessian(terms.model.hamiltonian, psi)[0]
        if _depends(ca.mtimes([L, hessian, L.T]), psi):
            return "the stored energy is not quadratic in the states of its branches (saturation)"
        S = ca.Function("S", [self.x, *(p.sx for p in terms.model.parameters)], [ca.mtimes([L, hessian, L.T])])
        start = [np.array([s for v in terms.model.states for s in v.start]), *(p.start for p in terms.model.parameters)]
        values = np.linalg.eigvalsh(np.array(S(*start)))
        return "" if values[0] > 1e-12 * values[-1] else "its inductance matrix is singular (isolated neutral)"

    def impulse_terms(self, rows: list[int]) -> list[Term]:
        """One term per member and cluster: L, c = its part of the rows, S, in the member's own states."""
        terms, model = self.terms, self.terms.model
        locator = Locator(model, terms.pairs)
        out = []
        for cluster in self._clusters(rows):
            states = sorted(set().union(*(self._states(r) for r in cluster)))
            for owner in dict.fromkeys(self.owner[i] for i in states):
                own = [i for i in states if self.owner[i] == owner]
                touched = [r for r in cluster if self._states(r) & set(own)]
                psi = ca.vertcat(*(self.x[i] for i in own))
                energy = ca.SX(0)
                for e in model.energies:
                    energy += e.expr if terms.members[owner] == e.owner or len(terms.members) == 1 else 0
                L = ca.vertcat(*(self.L[r][0, own] for r in touched)).T
                hessian, gradient = ca.hessian(energy, psi)
                exprs = {"L": ca.densify(L), "c": -ca.mtimes(L.T, gradient), "S": ca.mtimes([L.T, hessian, L])}
                out.append(
                    make_term("impulse", {k: ca.densify(v) for k, v in exprs.items()}, locator, "bare node",
                              rows=[("x", i) for i in own] + [("a", r) for r in touched], owner=owner,
                              extra=ca.vertsplit(psi))
                )  # fmt: skip
        return out


def terms_algebraics(terms: Terms) -> ca.SX:
    return ca.vertcat(*(v.sx for v in terms.model.algebraics))


def _depends(expr: ca.SX, on: ca.SX) -> bool:
    """Structural dependence after cancelling what differentiates to zero."""
    return ca.simplify(ca.jacobian(ca.densify(expr), on)).nnz() > 0 and ca.depends_on(expr, on)


def _state_owners(terms: Terms) -> dict[int, int]:
    """State -> the member whose energy contains it."""
    return {i: t.owner for t in terms.terms if t.kind in ("energy", "joint", "closed") for _, i in t.rows}


def _marked(t: Term, shifted: set[int]) -> Term:
    """A term with the local places of shifted states as data; they are part of its key."""
    where = tuple(j for j, i in enumerate(t.index.get("x", ())) if i in shifted)
    return replace(t, key=("shifted", where, t.key), data=t.data | {"shifted": where}) if where else t


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

    y = spec.y + [(("s0", j, 0), s) for j, s in zip(where, symbols, strict=True)]
    out = [(a, power, ca.substitute(e, spec.x, x)) for a, power, e in spec.out]
    return replace(spec, y=y, out=out, stored=moved(spec.stored), lost=moved(spec.lost))


def specs(term: Term, nd: Nodes) -> list[Spec]:
    """Rows of the impulses and shifts, and their work."""
    args = Arguments(term, nd.k)
    x, n = term.local["x"], term.local["x"].numel()
    n_psi = sum(kind == "x" for kind, _ in term.rows)
    places = range(n_psi, len(term.rows))
    d = args.matrix("D", n)
    s0, s1 = (ca.vertcat(*(args.symbol(kind, j, 0) for j in range(n_psi))) for kind in ("s0", "s1"))
    m = ca.vertcat(*(args.symbol("i0", j, 0) for j in places))
    roots = [ca.vertcat(*(args.symbol("i1", j, i) for j in places)) for i in range(POINTS)]
    end = _sum(roots) * ((-1.0) ** nd.k / POINTS)
    rest = ca.SX(n - n_psi, 1)
    x_start = x + ca.vertcat(s0, rest)
    x_end = x_start + ca.mtimes(d, ca.DM(nd.b))

    def at(name: str, value: ca.SX) -> ca.SX:
        return ca.substitute(term.data[name], x, value)

    S0, S1 = at("S", x), at("S", x_end)
    out: list[tuple[Address, int, ca.SX]] = []
    for kind, s, shift in (("s0", s0, ca.mtimes(at("L", x), m)), ("s1", s1, ca.mtimes(at("L", x_end), end))):
        out += [((kind, j, 0), 0, s[j] - shift[j]) for j in range(n_psi)]
    for i, root in enumerate(roots):
        angle = (2 * i + 1) * np.pi / (4 * POINTS)
        row = np.cos(angle) ** 2 * ca.mtimes(S1, root) + np.sin(angle) ** 2 * ca.mtimes(S0, root) - ca.mtimes(S0, m)
        out += [(("i1", j, i), 0, row[j - n_psi]) for j in places]
    x_new = x_end + ca.vertcat(s1, rest)
    c = [at("c", v) for v in (x, x_start, x_end, x_new)]
    out += [(("i0", j, 0), 0, c[3][j - n_psi]) for j in places]
    work = -(m * (c[0] + c[1]) + end * (c[2] + c[3])) / 2  # y = -c; exact, as H is quadratic along L
    booked = [(("work", j, 0), 0, work[j - n_psi]) for j in places]
    return [
        Spec(1, args.x, args.p, args.y, out),
        Spec(1, args.x, args.p, args.y, booked, stored=ca.sum1(work), report=True),
    ]


def _sum(values: list[ca.SX]) -> ca.SX:
    total = values[0]
    for v in values[1:]:
        total += v
    return total


def unknowns(terms: Terms) -> list[tuple[str, int, int]]:
    """Impulses and roots per bare row, shifts per shifted state."""
    out = [("i0", r, 0) for r in terms.impulse_rows]
    out += [("i1", r, i) for r in terms.impulse_rows for i in range(POINTS)]
    return out + [(kind, i, 0) for kind in ("s0", "s1") for i in terms.shifted]


def update(layout: Layout) -> list[tuple[int, int, float]]:
    """x' gets both shifts."""
    return [(i, layout.w_of[(kind, i, 0)], 1.0) for i in layout.terms.shifted for kind in ("s0", "s1")]


def mean(layout: Layout) -> list[tuple[int, int, float, int]]:
    """Node voltages: interval means include the impulses, (m + m')/h."""
    sign = (-1.0) ** layout.k / POINTS
    out = [(r, layout.w_of[("i0", r, 0)], 1.0, -1) for r in layout.terms.impulse_rows]
    return out + [(r, layout.w_of[("i1", r, i)], sign, -1) for r in layout.terms.impulse_rows for i in range(POINTS)]


def work(layout: Layout) -> list[tuple[int, int]]:
    """(pair, row of R) of the energy that impulses carry through a port of a composed network."""
    terms, out = layout.terms, []
    for t in terms.terms:
        if t.kind == "impulse":
            for j, (kind, r) in enumerate(t.rows):
                pairs = [i for i, p in enumerate(terms.pairs) if terms.bound.get(i) == r and p.owner == t.owner]
                if kind == "a" and pairs:
                    out.append((pairs[0], layout.result(t, ("work", j, 0))))
    return out
