"""Collocation at k Gauss nodes with discrete gradients: order 2k, exact power balance with R and ports.

Unknowns per node i: increments D_i = h x1'(t + c_i h) and algebraic values x2_i.  With X_i = x + sum_j a_ij D_j,

    E11(X_i) D_i = h [(J - R) Z_i + B u_i]_1,   0 = [(J - R) Z_i + B u_i]_2,   y_i = B^T Z_i,   x' = x + sum_i b_i D_i,

and E11^T Z_i = W_i, the node gradients of `gradients.py`.  k = 1 is the scheme (21) of Kinon, Morandin, Schulze
(Appl. Numer. Math. 2026), for holonomic models their (44).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from phfmu.discretise import closure, constraints, gradients, impulses, inertia
from phfmu.discretise.arguments import EMPTY, Arguments
from phfmu.discretise.discrete import Summand, node_gradients
from phfmu.discretise.layout import Layout
from phfmu.discretise.planner import Maps
from phfmu.discretise.quadrature import Nodes, nodes, radau_nodes
from phfmu.discretise.scheme import Triplet, Unknown, node_constants, node_maps, node_unknowns
from phfmu.discretise.spec import Spec, substituted
from phfmu.discretise.terms import DeclarationError, Term, Terms


@dataclass(frozen=True)
class Collocated:
    """k Gauss nodes, or k Radau nodes.

    gradient: "per-term" | "mean-value" | "joint-gonzalez", "itoh-abe", "itoh-abe-symmetric", "nodal" (these k = 1; nodal
    is the midpoint baseline MP, which keeps no energy balance).

    `closure` (k = 1): where x2 of a step belongs, "end" | "start" | "midpoint" of `closure.py`; "mean": the mean over the
    step is reported and nothing is carried on.
    `two_level`: holonomic models keep position and velocity constraints both (GGL form, odd k).
    `impulses`: neutral impulse pairs at bare nodes, where their conditions hold (`impulses.py`); not with a closure.
    `radau`: Radau IIA nodes and nodal gradients, see `radau`.
    """

    k: int = 1
    gradient: str = "per-term"
    name: str = "collocated"
    two_level: bool = False
    impulses: bool = True
    closure: str = "mean"
    radau: bool = False

    @property
    def joint(self) -> bool:
        return self.gradient == "joint-gonzalez"

    @property
    def order(self) -> int:
        return 1 if self.gradient == "itoh-abe" else 2 * self.k - self.radau

    @property
    def nodes(self) -> Nodes:
        return radau_nodes(self.k) if self.radau else nodes(self.k)

    def unknowns(self, terms: Terms) -> list[Unknown]:
        out = node_unknowns(terms, self.k)
        if self.closure != "mean":
            out += closure.unknowns(terms)
        if self.two_level:
            out += [("m", t.rows[0][1], 0) for t in terms.terms if t.kind == "constraint"]
        return out + impulses.unknowns(terms)

    def constants(self, layout: Layout) -> list[Triplet]:
        return node_constants(layout)

    def maps(self, layout: Layout) -> Maps:
        if self.closure != "mean":
            return closure.maps(layout)
        maps = node_maps(layout, self.nodes)
        return replace(
            maps,
            update=maps.update + impulses.update(layout),
            mean=maps.mean + impulses.mean(layout),
            work=impulses.work(layout),
        )

    def prepare(self, terms: Terms) -> Terms:
        """Check that the scheme fits the model; returns the terms to discretise."""
        for pair in terms.model.closed:
            if pair.ebar is None or pair.zbar is None:
                names = ", ".join(v.name for v in pair.variables)
                raise DeclarationError(f"{terms.model.name}: the pair (E, z) on {names} has no discrete pair; give ebar and "
                                       "zbar, or use --scheme dirac-dissipative")  # fmt: skip
        if terms.closed_states and self.radau:
            raise DeclarationError(
                f"{terms.model.name}: the closed-form pair has no Radau form; use flux coordinates, or --scheme collocated"
            )
        if terms.closed_states and self.k > 1:
            raise DeclarationError(
                f"{terms.model.name}: the closed-form pair has order 2 only; use --order 2, or flux coordinates for "
                f"order {2 * self.k}"
            )
        if self.k > 1 and self.gradient not in ("per-term", "mean-value") and not self.radau:
            raise DeclarationError(f"{self.gradient} has order 2 at most; use --gradient per-term for a higher order")
        if (
            terms.velocity_of
            and self.k % 2 == 0
            and not self.radau
            and any(t.kind == "constraint" for t in terms.terms)
        ):
            raise DeclarationError(
                f"{terms.model.name}: order {2 * self.k} with holonomic constraints drifts off the velocity constraint; "
                "use --order 2 or 6"
            )
        if self.closure != "mean":
            closure.require(self.closure, self.name)
            if self.k > 1 or self.two_level:
                raise DeclarationError(f"closure {self.closure} of {self.name} is for order 2 without a velocity level; "
                                       "use --scheme semi-explicit --order 2, or leave out --closure")  # fmt: skip
            return closure.add(terms)
        if self.two_level:
            terms = inertia.prepare(terms)
        if terms.light and self.gradient not in ("per-term", "mean-value"):
            names = [n for v in terms.model.states for n in v.names()]
            raise DeclarationError(
                f"{terms.model.name}: {', '.join(names[i] for i in terms.light[:6])} without mass have no {self.gradient} "
                "gradient; use --gradient per-term"
            )
        return impulses.prepare(terms) if self.impulses else terms

    def specs(self, term: Term) -> list[Spec]:
        """Kernels of one term."""
        if term.kind == "impulse":
            return impulses.specs(term, self.nodes)
        build = getattr(self, "_" + term.kind, None)
        return [] if build is None else [impulses.shifted(s, term) for s in build(term)]

    def _closure(self, term: Term) -> list[Spec]:
        return closure.specs(term, self.closure)

    # -- terms ------------------------------------------------------------------------------------------------------

    def _energy(self, term: Term) -> list[Spec]:
        args, x, data = Arguments(term, self.k), term.local["x"], term.data
        d = args.matrix("D", x.numel())
        tag = term.key[1]
        strain = (data["C"], data["phi"], term.local["z"]) if tag[0] == "strain" else None
        metric = np.array(tag[1]) if tag[0] == "general" else None
        if tag[0] == "quadratic" and not self.gradient.startswith("itoh-abe"):
            w, dh = gradients.quadratic(data["H"], data["z"], x, d, self.nodes)
            numerical = gradients.numerical_loss(data["H"], x, d, w, dh, self.nodes) if self.radau else None
            return [self._costates(args, w, dh, numerical)]
        w, dh = node_gradients(self.gradient, Summand(tag[0], data["H"], x, strain, metric), d, self.nodes)
        numerical = gradients.numerical_loss(data["H"], x, d, w, dh, self.nodes) if self.radau else None
        return [self._costates(args, w * ca.repmat(data["scale"], 1, self.k), dh, numerical)]

    def _joint(self, term: Term) -> list[Spec]:
        args, x = Arguments(term, self.k), term.local["x"]
        d = args.matrix("D", x.numel())
        w, dh = gradients.joint_gonzalez(term.data["H"], x, d, self.nodes)
        return [self._costates(args, w * term.data["scale"], dh)]

    def _costates(self, args: Arguments, w: ca.SX, dh: ca.SX, numerical: ca.SX | None = None) -> Spec:
        out = [(("W", j, i), 0, w[j, i]) for i in range(self.k) for j in range(w.shape[0])]
        return Spec(0, args.x, args.p, args.y, out, stored=dh, numerical=numerical)

    def _closed(self, term: Term) -> list[Spec]:
        args, x, data = Arguments(term, 1), term.local["x"], term.data
        d = args.matrix("D", x.numel())
        ebar, zbar = substituted([data["ebar"], data["zbar"]], [(term.local["z"], d)])
        dh = gradients.at(data["H"], x, x + d) - data["H"]
        rows = range(x.numel())
        costates = Spec(0, args.x, args.p, args.y, [(("W", j, 0), 0, zbar[j]) for j in rows], stored=dh)
        return [costates, Spec(1, args.x, args.p, args.y, [(("row", j, 0), 0, ebar[j]) for j in rows])]

    def _mass(self, term: Term) -> list[Spec]:
        args = Arguments(term, self.k)
        d, m = args.matrix("D", 1), term.data["m"]
        out = [(("row", 0, i), 0, m * d[i]) for i in range(self.k)]
        if "light" not in term.data:
            return [Spec(1, EMPTY, args.p, args.y, out)]
        # equal increments, and the shift of the velocity in the mean: sum b_i m (z_i - v_i) = sum b_i S_i^T mu
        nd, v, z = self.nodes, term.local["x"], args.matrix("Z", 1)
        shift = sum((nd.b[i] * (z[i] - v - ca.mtimes(d, ca.DM(nd.a[i]))) for i in range(self.k)), ca.SX(0))
        out += [(("costate", 0, i), 0, d[i + 1] - d[i]) for i in range(self.k - 1)]
        out.append((("costate", 0, self.k - 1), 0, m * shift))
        return [Spec(1, v, args.p, args.y, out)]

    def _massblock(self, term: Term) -> list[Spec]:
        args, n = Arguments(term, self.k), len(term.rows)
        pairs, e = self._at_nodes(term, args)
        out = []
        d = e["D"]
        for i in range(self.k):
            (matrix,) = substituted([term.data["E"]], pairs[i])
            (z,) = substituted([term.data["z"]], pairs[i])
            lhs, back = ca.mtimes(matrix, d[:n, i]), ca.mtimes(matrix.T, z)
            out += [(("row", j, i), 0, lhs[j]) for j in range(n)]
            out += [(("costate", j, i), 0, back[j]) for j in range(n)]
        return [Spec(1, args.x, args.p, args.y, out)]

    def _at_nodes(self, term: Term, args: Arguments) -> tuple[list[list[tuple[ca.SX, ca.SX]]], dict[str, ca.SX]]:
        """Per node the substitution of local symbols by their node values; and the argument matrices by kind."""
        nd, made = self.nodes, {}
        local = term.local
        if "x" in local:
            made["D"] = args.matrix("D", local["x"].numel())
        step = args.symbol("h", 0, 0) if "t" in local else None
        for kind in ("z", "a", "u"):
            if kind in local:
                made[kind] = args.matrix(kind, local[kind].numel())
        pairs = []
        for i in range(self.k):
            at = [(local[kind], made[kind][:, i]) for kind in ("z", "a", "u") if kind in local]
            if "x" in local:
                at.append((local["x"], local["x"] + ca.mtimes(made["D"], ca.DM(nd.a[i]))))
            if step is not None:
                at.append((local["t"], local["t"] + nd.c[i] * step))
            pairs.append(at)
        return pairs, made

    def _flow(self, term: Term) -> list[Spec]:
        args = Arguments(term, self.k)
        pairs, _ = self._at_nodes(term, args)
        out, lost = [], None
        for i in range(self.k):
            (f,) = substituted([term.data["f"]], pairs[i])
            for j, (kind, _) in enumerate(term.rows):
                out.append((("row", j, i), int(kind == "x"), f[j] if kind == "y" else -f[j]))
            if "loss" in term.data:
                (loss,) = substituted([term.data["loss"]], pairs[i])
                lost = self.nodes.b[i] * loss + (0 if lost is None else lost)
        return [Spec(1, args.x, args.p, args.y, out, lost=lost)]

    def _source(self, term: Term) -> list[Spec]:
        args = Arguments(term, self.k)
        pairs, _ = self._at_nodes(term, args)
        out = [(("S", 0, i), 0, substituted([term.data["s"]], pairs[i])[0]) for i in range(self.k)]
        return [Spec(0, args.x, args.p, args.y, out)]

    def _constraint(self, term: Term) -> list[Spec]:
        build = constraints.two_level if self.two_level else constraints.collocated
        return build(term, self.nodes)


def radau(k: int = 2) -> Collocated:
    """Radau IIA with k stages: order 2k - 1, stiff decay is damped and the damping booked as numerical loss.

        sum_i b_i D_i^T grad H(X_i) = H(x') - H(x) + loss,     stored + dissipated + loss = supplied.

    loss >= 0 for quadratic H (algebraic stability: K. Burrage, J. C. Butcher, SIAM J. Numer. Anal. 16, 1979).
    """
    return Collocated(k, gradient="nodal", name="radau", radau=True, impulses=False)
