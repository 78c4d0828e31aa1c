"""Kernels of the terms of a declaration at k nodes, shared by all schemes with increments at nodes.

With increments D_i and X_i = x + sum_j a_ij D_j, everything in a row of (J - R) z + B u is taken at X_i and at the other
values of node i; energies become node gradients.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from phfmu.declare.energy import EnergyKind
from phfmu.declare.variable import ValueKind
from phfmu.gradients import gradients
from phfmu.gradients.discrete import Summand, node_gradients
from phfmu.gradients.quadrature import Nodes
from phfmu.plan.address import READ, Address, costate_row, gradient, increment, row, source, step_size
from phfmu.plan.spec import Arguments, Result, Spec, substituted
from phfmu.schemes.constraints import constraints
from phfmu.terms.located import Row
from phfmu.terms.term import CLOSED, CONSTRAINT, EMPTY, ENERGY, FLOW, JOINT, MASS, MASS_BLOCK, SOURCE, EnergyForm, Term


@dataclass(frozen=True)
class NodeKernels:
    """Kernels at `nodes` with a discrete gradient of `discrete.py`, or "nodal"; `loses_energy`: book the gradient's error."""

    nodes: Nodes
    gradient: str
    loses_energy: bool = False

    @property
    def k(self) -> int:
        return self.nodes.k

    def specs(self, term: Term) -> list[Spec]:
        """Kernels of one term, none for kinds that a step does not need."""
        build = {
            ENERGY: self._energy,
            JOINT: self._joint,
            CLOSED: self._closed,
            MASS: self._mass,
            MASS_BLOCK: self._mass_block,
            FLOW: self._flow,
            SOURCE: self._source,
            CONSTRAINT: self._constraint,
        }.get(term.kind)
        return [] if build is None else build(term)

    def _energy(self, term: Term) -> list[Spec]:
        args, x, data = Arguments(term, self.k), term.local[ValueKind.STATE], term.data
        d = args.matrix(increment, x.numel())
        form = term.form_of(EnergyForm)
        strain = (data["C"], data["phi"], term.local[ValueKind.INVARIANT]) if form.kind is EnergyKind.STRAIN else None
        metric = np.array(form.metric) if form.kind is EnergyKind.GENERAL else None
        if form.kind is EnergyKind.QUADRATIC and not self.gradient.startswith("itoh-abe"):
            w, dh = gradients.quadratic(data["H"], data["z"], x, d, self.nodes)
            return [self._costates(args, w, dh, self._loss(term, d, w, dh))]
        w, dh = node_gradients(self.gradient, Summand(form.kind, data["H"], x, strain, metric), d, self.nodes)
        loss = self._loss(term, d, w, dh)
        return [self._costates(args, w * ca.repmat(data["scale"], 1, self.k), dh, loss)]

    def _joint(self, term: Term) -> list[Spec]:
        args, x = Arguments(term, self.k), term.local[ValueKind.STATE]
        d = args.matrix(increment, x.numel())
        w, _ = gradients.joint_gonzalez(term.data["H"], x, d, self.nodes)
        parts = ca.vertsplit(term.data["parts"])
        booked = [Spec(0, args.x, args.p, args.y, [], stored=gradients.difference(h, x, d)) for h in parts]
        return [self._costates(args, w * term.data["scale"]), *booked]

    def _loss(self, term: Term, d: ca.SX, w: ca.SX, dh: ca.SX) -> ca.SX | None:
        if not self.loses_energy:
            return None
        return gradients.numerical_loss(term.data["H"], term.local[ValueKind.STATE], d, w, dh, self.nodes)

    def _costates(self, args: Arguments, w: ca.SX, dh: ca.SX | None = None, numerical: ca.SX | None = None) -> Spec:
        out = [(Address(gradient, j, i), 0, w[j, i]) for i in range(self.k) for j in range(w.shape[0])]
        return Spec(0, args.x, args.p, args.y, out, stored=dh, numerical=numerical)

    def _closed(self, term: Term) -> list[Spec]:
        args, x, data = Arguments(term, 1), term.local[ValueKind.STATE], term.data
        d = args.matrix(increment, x.numel())
        ebar, zbar = substituted([data["ebar"], data["zbar"]], [(term.local[ValueKind.INCREMENT], d)])
        dh = gradients.difference(data["H"], x, d)
        places = range(x.numel())
        costates = Spec(0, args.x, args.p, args.y, [(Address(gradient, j), 0, zbar[j]) for j in places], stored=dh)
        return [costates, Spec(1, args.x, args.p, args.y, [(Address(row, j), 0, ebar[j]) for j in places])]

    def _mass(self, term: Term) -> list[Spec]:
        args = Arguments(term, self.k)
        d, m = args.matrix(increment, 1), term.data["m"]
        return [Spec(1, EMPTY, args.p, args.y, [(Address(row, 0, i), 0, m * d[i]) for i in range(self.k)])]

    def _mass_block(self, term: Term) -> list[Spec]:
        args, n = Arguments(term, self.k), len(term.rows)
        pairs, d = self._at_nodes(term, args)
        out: list[Result] = []
        for i in range(self.k):
            (matrix,) = substituted([term.data["E"]], pairs[i])
            (z,) = substituted([term.data["z"]], pairs[i])
            lhs, back = ca.mtimes(matrix, d[:n, i]), ca.mtimes(matrix.T, z)
            out += [(Address(row, j, i), 0, lhs[j]) for j in range(n)]
            out += [(Address(costate_row, j, i), 0, back[j]) for j in range(n)]
        return [Spec(1, args.x, args.p, args.y, out)]

    def _at_nodes(self, term: Term, args: Arguments) -> tuple[list[list[tuple[ca.SX, ca.SX]]], ca.SX]:
        """Per node the substitution of local symbols by their node values; and the increments (states x k)."""
        nd, local = self.nodes, term.local
        d = args.matrix(increment, local[ValueKind.STATE].numel()) if ValueKind.STATE in local else EMPTY
        step = args.symbol(step_size) if ValueKind.TIME in local else None
        made = {kind: args.matrix(place, local[kind].numel()) for kind, place in READ.items() if kind in local}
        pairs = []
        for i in range(self.k):
            at = [(local[kind], values[:, i]) for kind, values in made.items()]
            if ValueKind.STATE in local:
                at.append((local[ValueKind.STATE], local[ValueKind.STATE] + ca.mtimes(d, ca.DM(nd.a[i]))))
            if step is not None:
                at.append((local[ValueKind.TIME], local[ValueKind.TIME] + nd.c[i] * step))
            pairs.append(at)
        return pairs, d

    def _flow(self, term: Term) -> list[Spec]:
        args = Arguments(term, self.k)
        pairs, _ = self._at_nodes(term, args)
        out: list[Result] = []
        lost = None
        for i in range(self.k):
            (f,) = substituted([term.data["f"]], pairs[i])
            for j, r in enumerate(term.rows):
                value = f[j] if r.kind in (Row.OUTPUT, Row.CONDENSED) else -f[j]
                out.append((Address(row, j, i), int(r.kind is Row.BALANCE), value))
            if "loss" in term.data:
                (loss,) = substituted([term.data["loss"]], pairs[i])
                lost = self.nodes.b[i] * loss + (0 if lost is None else lost)
        report = all(r.kind is Row.CONDENSED for r in term.rows) and lost is None
        return [Spec(1, args.x, args.p, args.y, out, lost=lost, report=report)]

    def _source(self, term: Term) -> list[Spec]:
        args = Arguments(term, self.k)
        pairs, _ = self._at_nodes(term, args)
        out = [(Address(source, 0, i), 0, substituted([term.data["s"]], pairs[i])[0]) for i in range(self.k)]
        return [Spec(0, args.x, args.p, args.y, out)]

    def _constraint(self, term: Term) -> list[Spec]:
        return constraints.collocated(term, self.nodes)
