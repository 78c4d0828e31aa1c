"""The instant plan: outputs, observables, energies and algebraic variables at one instant.

Given x, t and u:  algebraic rows that contain algebraic variables are solved as they are (index 1); rows that contain
states only are differentiated once (index 2: Kirchhoff at bare nodes, holonomic constraints) and solved together with
x1' from E11 x1' = [(J - R) z + B u]_1.  The undifferentiated rows are reported as checks of a consistent state.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from phfmu.discretise.arguments import EMPTY, Arguments
from phfmu.discretise.hidden import rates
from phfmu.discretise.layout import Layout
from phfmu.discretise.plan import Plan
from phfmu.discretise.planner import Maps, make_plan
from phfmu.discretise.rest import holds
from phfmu.discretise.spec import Address, Spec
from phfmu.discretise.terms import DeclarationError, Hidden, Term, Terms


@dataclass(frozen=True)
class Check:
    """A hidden constraint of the state: row of an algebraic variable, level "velocity" (the row) or "position" (g)."""

    name: str
    level: str
    row: int


def instant_plan(terms: Terms, rests: bool = True) -> tuple[Plan, list[Check]]:
    """The instant plan and its checks (reported as the last observables); `rests`: redundant constraints may rest."""
    hidden = terms.hidden
    if hidden.rows and terms.solved_costates:
        raise DeclarationError(
            f"{terms.model.name}: constraints together with a non-diagonal or state-dependent E are not supported yet; "
            "use coordinates with a diagonal E"
        )
    unknowns = [("D", i, 0) for i in range(terms.n1)] if hidden.rows else []
    unknowns += [("Z", i, 0) for i in terms.solved_costates]
    unknowns += [("a", i, 0) for i in range(terms.na)]
    unknowns += [("b", i, 0) for i in sorted(hidden.solved_by.values())]
    names = [n for v in terms.model.algebraics for n in v.names()]
    checks, rows = [], {}
    position = {t.rows[0][1] for t in terms.terms if t.kind == "constraint"}
    for level, code, which in (("velocity", 0, hidden.checks), ("position", 1, sorted(position))):
        for a in which:
            rows[(a, code)] = len(terms.observable_names) + len(checks)
            checks.append(Check(names[a], level, a))
    layout = Layout(terms, 1, unknowns, costate_rate=bool(hidden.rows), checks=rows, solved_by=hidden.solved_by)
    rule = _Instant(hidden, terms.bound)
    cache: dict[tuple, list[Spec]] = {}
    work = []
    for term in terms.terms:
        key = (term.key, tuple((r[0] == "a" and r[1] in hidden.rows, r[1] in hidden.solved_by) for r in term.rows))
        if key not in cache:
            cache[key] = rule.specs(term)
        work.append((term, cache[key]))
    mean = [(i, layout.w_of[("a", i, 0)], 1.0, 0) for i in range(terms.na)]
    guess = [[(w, 1.0, 0)] for w in range(layout.nw)]
    nobs = len(terms.observable_names) + len(checks)
    maps = Maps([], mean, guess, np.ones(1), np.full(1, 0.5))
    hold = holds(layout) if rests else None
    return make_plan(layout, work, _constants(layout, hidden), maps, na=terms.na, nobs=nobs, hold=hold), checks


@dataclass(frozen=True)
class _Instant:
    """Kernels of the instant plan."""

    hidden: Hidden
    bound: dict[int, int]

    @property
    def rate(self) -> bool:
        """True if x1' is among the unknowns."""
        return bool(self.hidden.rows)

    def specs(self, term: Term) -> list[Spec]:
        build = getattr(self, "_" + term.kind, None)
        return [] if build is None else build(term)

    def _energy(self, term: Term) -> list[Spec]:
        args, x = Arguments(term, 1), term.local["x"]
        w = term.data["z"] if "z" in term.data else ca.gradient(term.data["H"], x) * term.data["scale"]
        return [self._costates(args, x, w, term.data["H"])]

    _joint = _energy

    def _costates(self, args: Arguments, x: ca.SX, w: ca.SX, h: ca.SX) -> Spec:
        rows = range(x.numel())
        out: list[tuple[Address, int, ca.SX]] = [(("W", j, 0), 0, w[j]) for j in rows]
        if self.rate:
            dw = ca.jtimes(w, x, args.matrix("r", x.numel()))
            out += [(("Q", j, 0), 0, dw[j]) for j in rows]
        return Spec(0, args.x, args.p, args.y, out, stored=h)

    def _closed(self, term: Term) -> list[Spec]:
        args, x = Arguments(term, 1), term.local["x"]
        specs = [self._costates(args, x, term.data["z"], term.data["H"])]
        if self.rate:
            args = Arguments(term, 1)
            e = ca.mtimes(term.data["E"], args.matrix("r", x.numel()))
            specs.append(Spec(1, args.x, args.p, args.y, [(("row", j, 0), 0, e[j]) for j in range(x.numel())]))
        return specs

    def _mass(self, term: Term) -> list[Spec]:
        if not self.rate:
            return []
        args = Arguments(term, 1)
        r = args.matrix("D", 1)
        return [Spec(1, EMPTY, args.p, args.y, [(("row", 0, 0), 0, term.data["m"] * r)])]

    def _massblock(self, term: Term) -> list[Spec]:
        args, n = Arguments(term, 1), len(term.rows)
        z = args.matrix("z", n)
        back = ca.mtimes(term.data["E"].T, z)
        return [Spec(1, args.x, args.p, args.y, [(("costate", j, 0), 0, back[j]) for j in range(n)])]

    def _source(self, term: Term) -> list[Spec]:
        args, s = Arguments(term, 1), term.data["s"]
        out: list[tuple[Address, int, ca.SX]] = [(("S", 0, 0), 0, s)]
        if self.rate:
            out.append((("SR", 0, 0), 0, ca.gradient(s, term.local["t"]) if "t" in term.local else ca.SX(0)))
        return [Spec(0, args.x, args.p, args.y, out)]

    def _flow(self, term: Term) -> list[Spec]:
        args, local, f = Arguments(term, 1), term.local, term.data["f"]
        chosen = [j for j, (kind, i) in enumerate(term.rows) if kind == "a" and i in self.hidden.rows]
        made = {k: args.matrix(k, local[k].numel()) for k in ("z", "a", "u") if k in local}
        drift = self._drift(term, args, chosen) if chosen else ca.SX(f.numel(), 1)
        f, drift = ca.substitute([f, drift], [local[k] for k in made], list(made.values()))
        out: list[tuple[Address, int, ca.SX]] = []
        for j, (kind, i) in enumerate(term.rows):
            if kind == "x" and not self.rate:
                continue
            value = f[j] if kind == "y" else -(drift[j] if j in chosen else f[j])
            out.append((("row", j, 0), 0, value))
            if j in chosen and i in self.hidden.solved_by:
                out.append((("original", j, 0), 0, -f[j]))
            elif j in chosen:
                out.append((("check", j, 0), 0, f[j]))
        return [Spec(1, args.x, args.p, args.y, out)] if out else []

    def _drift(self, term: Term, args: Arguments, chosen: list[int]) -> ca.SX:
        """df/dt along x1', the costate rates and the rates of algebraic variables; held inputs have none."""
        local, f = term.local, term.data["f"]
        drift = ca.SX(f.numel(), 1)
        if "x" in local:
            drift += ca.jtimes(f, local["x"], args.matrix("r", local["x"].numel()))
        if "z" in local:
            drift += ca.jtimes(f, local["z"], args.matrix("dz", local["z"].numel()))
        if "t" in local:
            drift += ca.jacobian(f, local["t"])
        for kind, i in rates(term, chosen, self.bound):
            drift += ca.jacobian(f, local[kind][i]) * args.symbol("d" + kind, i, 0)
        return drift

    def _observable(self, term: Term) -> list[Spec]:
        args, local, f = Arguments(term, 1), term.local, term.data["f"]
        made = {k: args.matrix(k, local[k].numel()) for k in ("z", "a", "u") if k in local}
        (f,) = ca.substitute([f], [local[k] for k in made], list(made.values()))
        return [Spec(1, args.x, args.p, args.y, [(("row", j, 0), 0, f[j]) for j in range(f.numel())])]

    def _constraint(self, term: Term) -> list[Spec]:
        args, q, g = Arguments(term, 1), term.local["x"], term.data["g"]
        n = q.numel()
        z, dz, lam, r = args.matrix("v", n), args.matrix("Q", n), args.matrix("l", 1), args.matrix("r", n)
        grad, t = ca.gradient(g, q), term.local.get("t")
        moving = ca.SX(0) if t is None else ca.gradient(g, t)
        speed = ca.dot(grad, z) + moving
        rate = ca.dot(grad, dz) + ca.dot(ca.gradient(speed, q), r)
        rate += 0 if t is None else ca.gradient(speed, t)
        out: list[tuple[Address, int, ca.SX]] = [(("velocity", j, 0), 0, grad[j] * lam) for j in range(n)]
        out += [(("row", 0, 0), 0, -rate), (("check", 0, 0), 0, speed), (("check", 0, 1), 0, g)]
        if t is not None:
            out.append((("row", 1, 0), 0, lam * moving))
        return [Spec(1, args.x, args.p, args.y, out)]


def _constants(layout: Layout, hidden: Hidden) -> list[tuple[int, int, float, int]]:
    terms, out = layout.terms, []
    other = {i for t in terms.terms if t.kind in ("mass", "massblock", "closed") for _, i in t.rows}
    if hidden.rows:
        out += [(layout.row("x", i, 0), layout.value("D", i, 0), 1.0, 0) for i in range(terms.n1) if i not in other]
    out += [(layout.w_of[("Z", i, 0)], layout.nv + layout.slot(i, 0), -1.0, 0) for i in terms.solved_costates]
    for kind, row, source_kind, source, value in terms.constants:
        if kind == "x" and not hidden.rows:
            continue
        src = layout.value(source_kind, source, 0)
        if kind == "a" and row in hidden.rows:
            if row in hidden.solved_by:
                out.append((layout.w_of[("b", hidden.solved_by[row], 0)], src, -value, 0))
            else:
                out.append((layout.row("o", layout.checks[(row, 0)], 0), src, value, 0))
            rate = _rate(layout, source_kind, source)
            if rate is not None:
                out.append((layout.row("a", row, 0), rate, -value, 0))
        else:
            out.append((layout.row(kind, row, 0), src, value if kind == "y" else -value, 0))
    return out


def _rate(layout: Layout, kind: str, i: int) -> int | None:
    """Y index of the time derivative of a value in a differentiated row; held inputs have none."""
    if kind == "z":
        return layout.value("Q", i, 0)
    if kind == "a":
        return layout.value("b", i, 0)
    if i in layout.bound:
        return layout.value("b", layout.bound[i], 0)
    if i in layout.source_slot:
        return layout.nv + layout.source_index(i, 0) + len(layout.sources)
    return None
