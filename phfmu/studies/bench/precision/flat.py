"""A declaration as one flat system: rates, right-hand sides and constraints in x, a, t, parameters and inputs."""

from __future__ import annotations

import casadi as ca

from phfmu.declare.entries.coefficients import coefficient, square, stacked
from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import ValueKind, _sx, time
from phfmu.terms.canonical import Locator
from phfmu.terms.term import Terms
from phfmu.terms.velocities import velocity_of


class FlatSystem:
    """A declaration as one flat system of expressions."""

    def __init__(self, declaration: PHDAE, terms: Terms):
        self.declaration, self.terms = declaration, terms
        self.x = declaration.x if declaration.states else ca.SX(0, 1)
        self.a = ca.vertcat(*(v.sx for v in declaration.algebraics)) if declaration.algebraics else ca.SX(0, 1)
        self._locator = Locator(declaration, terms.pairs)
        self._mass = self._mass_blocks()
        z, gradient = ca.SX(self.x.numel(), 1), ca.gradient(declaration.hamiltonian, self.x)
        for where, e, given in self._mass:
            z[where] = given if given is not None else _divide(e.T, gradient[where])
        self._z = ca.vertcat(*(v.z for v in declaration.states)), ca.densify(z)
        self.constraint_rows = [i for c in declaration.constraints for i in self._where(c.multiplier)]
        self.constraints = [c.g[j] for c in declaration.constraints for j in range(c.g.numel())]

    def _where(self, v) -> list[int]:
        return [at.index for at in self._locator.of(v)]

    def _mass_blocks(self) -> list[tuple[list[int], ca.SX, ca.SX | None]]:
        """(states, E of them, costate where it is given): every state once."""
        d, out, done = self.declaration, [], set()
        for pair in d.closed:
            where = [i for v in pair.variables for i in self._where(v)]
            out.append((where, ca.SX(pair.E), ca.SX(pair.z)))
            done.update(id(v) for v in pair.variables)
        for key, value in d.E.items():
            where = [i for v in stacked(key) for i in self._where(v)]
            out.append((where, square(value, len(where)), None))
            done.update(id(v) for v in stacked(key))
        out += [(self._where(v), ca.SX.eye(v.n), None) for v in d.states if id(v) not in done]
        return out

    def rates(self, f: ca.SX) -> ca.SX:
        """x' = E^-1 f."""
        rate = ca.SX.zeros(self.x.numel())
        for where, e, _ in self._mass:
            rate[where] = _divide(e, f[where])
        return rate

    def right_hand_side(self) -> ca.SX:
        """(J - R) z + B u on all rows, in x, a, t, parameters and free inputs."""
        d, n1, locator = self.declaration, self.terms.n1, self._locator
        f = ca.SX.zeros(n1 + self.terms.na)

        def at(variables) -> list[int]:
            return [at.index + n1 * (at.kind is not ValueKind.STATE) for v in variables for at in locator.of(v)]

        for sign, blocks in ((1.0, d.structure), (-1.0, d.dissipation)):
            for block in blocks:
                z = ca.vertcat(*(self._effort(v) for v in block.variables))
                rows = [r for v in block.variables for r in (at([v]) if v.kind != "port" else self._port_rows(v))]
                for row, value in zip(rows, ca.vertsplit(ca.mtimes(block.matrix, z)), strict=True):
                    if row is not None:
                        f[row] += sign * value
        for port in d.ports:
            self._add_port(f, port, at)
        for row, g in zip(self.constraint_rows, self.constraints, strict=True):
            jac = ca.jacobian(g, self.x)
            f[n1 + row] += ca.jacobian(g, time)
            for q in sorted(set(jac.sparsity().get_triplet()[1])):
                v = velocity_of(self.terms)[q]
                f[v] -= jac[0, q] * self.a[row]
                f[n1 + row] += jac[0, q] * self._z[0][v]
        return ca.substitute(f, *self._z)

    def _effort(self, v) -> ca.SX:
        """Costate of a variable in a block; of a port its input, or what feeds it."""
        return ca.vertcat(*v.bound) if v.kind == "port" and v.bound is not None else self.declaration.effort(v)

    def _port_rows(self, port) -> list[int | None]:
        """The row that takes -y of each entry of a port in a block: that of the variable which feeds it, None without one."""
        bound = port.bound or [None] * port.n
        return [None if s is None else self.terms.n1 + self._locator.find(s, port.name).index for s in bound]

    def _add_port(self, f: ca.SX, port, at) -> None:
        n1 = self.terms.n1
        if port.source is not None:
            u = ca.SX(_sx(port.source))
        else:
            u = port.u if port.bound is None else ca.vertcat(*port.bound)
        for v, value in port.on.items():
            b = coefficient(value, v.n, port.n)
            f[at([v])] += ca.mtimes(b, u)
            if port.bound is not None:
                y = ca.mtimes(b.T, self.declaration.effort(v))
                for j, s in enumerate(port.bound):
                    f[n1 + self._locator.find(s, port.name).index] -= y[j]


def _divide(e: ca.SX, right: ca.SX) -> ca.SX:
    """e^-1 right; e is often diagonal."""
    if e.sparsity().is_diag():
        return right / ca.diag(e)
    return ca.solve(e, right)
