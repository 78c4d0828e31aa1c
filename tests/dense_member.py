"""A member written a second time: dense residual of collocation in CasADi, inputs at nodes, impulses, exact derivatives.

Of the package it uses the declaration and the discrete gradient of one energy; none of its tables, terms or engines.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from phfmu import PHDAE
from phfmu.declare.variable import time
from phfmu.gradients.discrete import Summand, node_gradients
from phfmu.gradients.quadrature import nodes


def _start(variables) -> np.ndarray:
    return np.concatenate([np.zeros(0), *(np.array(v.start, float) for v in variables)])


class DenseMember:
    """E x' = (J - R) z + B u, y = B^T z on k nodes, of a declaration without constraints and closed-form pairs.

    Impulses act on the ports in `taken`.  After `step`: Y (k x nu), y0, y1 (outputs of these ports before and after), work.
    """

    def __init__(self, d: PHDAE, k: int, taken: tuple[str, ...] = ()):
        assert not (d.constraints or d.closed or d.z)
        self.k, self.nd, self.d = k, nodes(k), d
        self.x, self.p, self.t = _start(d.states), _start(d.parameters), 0.0
        self._symbols()
        self._matrices()
        self._discretise()
        self._impulses(taken)
        self.w = np.tile(np.concatenate([np.zeros(self.n1), _start(d.algebraics)]), k)

    def _symbols(self) -> None:
        d = self.d
        free, fed = [q for q in d.ports if q.external], [q for q in d.ports if q.source is not None]
        self.ports = free + fed
        self.xs, self.zs = (ca.vertcat(ca.SX(0, 1), *(getattr(v, n) for v in d.states)) for n in ("sx", "z"))
        self.as_ = ca.vertcat(ca.SX(0, 1), *(v.sx for v in d.algebraics))
        self.ps = ca.vertcat(ca.SX(0, 1), *(v.sx for v in d.parameters))
        self.us = ca.vertcat(ca.SX(0, 1), *(q.u for q in self.ports))
        self.sources = ca.vertcat(ca.SX(0, 1), *(ca.SX(q.source) for q in fed))
        self.n1, self.na, self.nu = self.xs.numel(), self.as_.numel(), sum(q.n for q in free)
        self.place, at = {}, 0
        for q in free:
            self.place[q.name] = list(range(at, at + q.n))
            at += q.n

    def _matrices(self) -> None:
        """G = J - R and R on (z, algebraic variables, inputs), with the rows (x', 0, -y); the diagonal of E."""
        d = self.d
        where = {e.element_hash(): i for i, e in enumerate(ca.vertsplit(ca.vertcat(self.xs, self.as_, self.us)))}

        def at(v):
            return [where[e.element_hash()] for e in ca.vertsplit(v.sx)]

        n = len(where)
        self.G, self.R, self.E = ca.SX(n, n), ca.SX(n, n), ca.SX.ones(self.n1, 1)
        for sign, blocks in ((1, d.structure), (-1, d.dissipation)):
            for b in blocks:
                i = [j for v in b.variables for j in at(v)]
                self.G[i, i] += sign * b.matrix
                if sign < 0:
                    self.R[i, i] += b.matrix
        for q in self.ports:
            for v, m in q.on.items():
                m = ca.SX(getattr(m, "sx", m))
                m = m * ca.SX.eye(v.n) if m.numel() == 1 < v.n else m
                self.G[at(v), at(q)] += m
                self.G[at(q), at(v)] -= m.T
        for v, m in d.E.items():
            m = ca.SX(getattr(m, "sx", m))
            self.E[at(v)] = m if m.numel() == 1 else ca.diag(m) if m.shape[0] == m.shape[1] else m

    def _gradients(self, D: ca.SX) -> tuple[ca.SX, ca.SX]:
        W, dH = ca.SX(self.n1, self.k), ca.SX(0)
        nominal = np.array([x for v in self.d.states for x in v.nominal])
        for e in self.d.energies:
            s = ca.SX.sym("s")
            strain = None if e.invariant is None else (e.invariant, e.phi(s), s)
            has = {q.element_hash() for q in ca.symvar(e.expr)}
            own = [i for i in range(self.n1) if self.xs[i].element_hash() in has]
            chosen = {q.element_hash() for v in e.correct for q in ca.vertsplit(v.sx)} or has
            metric = np.array([self.xs[i].element_hash() in chosen for i in own]) / nominal[own] ** 2
            g, dh = node_gradients(
                "per-term", Summand(e.kind, e.expr, self.xs[own], strain, metric), D[own, :], self.nd
            )
            W[own, :] += g
            dH += dh
        return W, dH

    def _discretise(self) -> None:
        k, n1, na, nu, nd = self.k, self.n1, self.na, self.nu, self.nd
        D, A, U = ca.SX.sym("D", n1, k), ca.SX.sym("A", na, k), ca.SX.sym("U", nu, k)
        t, h = ca.SX.sym("t"), ca.SX.sym("h")
        W, dH = self._gradients(D)
        rows, Y, lost, fed = [], [], ca.SX(0), ca.SX(0)
        for i in range(k):
            X = self.xs + ca.mtimes(D, ca.DM(nd.a[i]))
            u = ca.vertcat(U[:, i], ca.substitute(self.sources, time, t + nd.c[i] * h))
            z = ca.vertcat(W[:, i] / self.E, A[:, i], u)
            old = ca.vertcat(self.xs, self.zs, self.as_, self.us, time)
            new = ca.densify(ca.vertcat(X, W[:, i] / self.E, A[:, i], u, t + nd.c[i] * h))
            G, R = ca.substitute([self.G, self.R], [old], [new])
            f = ca.mtimes(G, z)
            rows += [self.E * D[:, i] - h * f[:n1], f[n1 : n1 + na]]
            y = -f[n1 + na :]
            Y.append(y[:nu])
            lost += h * nd.b[i] * ca.dot(z, ca.mtimes(R, z))
            fed += h * nd.b[i] * ca.dot(u[nu:], y[nu:])
        w = ca.vertcat(*(ca.vertcat(D[:, i], A[:, i]) for i in range(k)))
        r, y, x1 = ca.vertcat(*rows), ca.vertcat(ca.SX(0, 1), *Y), self.xs + ca.mtimes(D, ca.DM(nd.b))
        points = [w, self.xs, ca.vec(U)]
        arguments = [*points, t, h, self.ps]

        def function(*results):
            return ca.Function("f", arguments, [ca.densify(v) for v in results])

        self._newton = function(r, ca.jacobian(r, w))
        self._results = function(y, x1, dH, lost, fed)
        self._slopes = function(*(ca.jacobian(v, q) for v in (r, y, x1) for q in points))

    def _impulses(self, taken: tuple[str, ...]) -> None:
        """y = B^T z, S and x + L s of the ports with impulses, with their derivatives."""
        n1, na, H = self.n1, self.na, self.d.hamiltonian
        self.taken = [i for name in taken for i in self.place[name]]
        s = ca.SX.sym("s", len(self.taken))
        L = self.G[:n1, [n1 + na + i for i in self.taken]] / ca.repmat(self.E, 1, len(self.taken))
        y, x = ca.mtimes(L.T, ca.gradient(H, self.xs)), self.xs + ca.mtimes(L, s)
        S = ca.mtimes([L.T, ca.hessian(H, self.xs)[0], L])
        made = [[y, S, ca.jacobian(y, self.xs)], [x, ca.jacobian(x, self.xs), ca.jacobian(x, s)]]
        self._port = ca.Function("p", [self.xs, self.ps], [ca.densify(v) for v in made[0]])
        self._shift = ca.Function("s", [self.xs, s, self.ps], [ca.densify(v) for v in made[1]])
        self._energy = ca.Function("H", [self.xs, self.ps], [H])

    def energy(self) -> float:
        return float(self._energy(self.x, self.p))

    def output(self) -> np.ndarray:
        return np.array(self._port(self.x, self.p)[0]).ravel()

    def jump(self) -> np.ndarray:
        return np.array(self._port(self.x, self.p)[1])

    def _solve(self, x, U, t, h) -> np.ndarray:
        w = self.w.copy()
        for _ in range(30):
            r, J = (np.array(v) for v in self._newton(w, x, U.ravel(), t, h, self.p))
            size = 1 / np.abs(J).max(axis=1)
            dw = -np.linalg.solve(J * size[:, None], r.ravel() * size)
            w = w + dw
            if np.max(np.abs(dw) / (1e-12 + np.abs(w))) < 1e-13:
                break
        return w

    def step(self, t: float, h: float, U: np.ndarray, s0=None, s1=None, parts: int = 1) -> None:
        """A step in `parts` equal ones: U (k x nu) at its nodes, impulses s0, s1 over the ports taken."""
        n, nd = len(self.taken), self.nd
        self.s0, self.s1 = (np.zeros(n) if s is None else np.asarray(s, float) for s in (s0, s1))
        self.y0, self.S0, self.path = self.output(), self.jump(), []
        self.x_old, x, Y, stored = self.x, np.array(self._shift(self.x, self.s0, self.p)[0]).ravel(), 0.0, 0.0
        self.lost = self.fed = 0.0
        for q in range(parts):
            basis = np.array([nd.value((q + c) / parts) for c in nd.c])
            back = (basis * nd.b[:, None] / nd.b).T / parts
            u, at, length = basis @ U, t + q * h / parts, h / parts
            self.w = self._solve(x, u, at, length)
            y, x1, dH, lost, fed = (
                np.array(v).ravel() for v in self._results(self.w, x, u.ravel(), at, length, self.p)
            )
            self.path.append((self.w, x, u, at, length, basis, back))
            Y, x, stored = Y + back @ y.reshape(self.k, -1), x1, stored + dH.item()
            self.lost, self.fed = self.lost + lost.item(), self.fed + fed.item()
        self.x_mid = x
        self.x = np.array(self._shift(x, self.s1, self.p)[0]).ravel()
        self.Y, self.y1 = Y, self.output()
        self.work = self.s0 * (self.y0 + self.S0 @ self.s0 / 2) + self.s1 * (self.y1 - self.jump() @ self.s1 / 2)
        self.stored = stored + self.work.sum()

    def sensitivity(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """d(Y, x, y1) / d(U node by node, s0, s1) by the implicit function theorem, step after step."""
        k, nu, n, m = self.k, self.nu, len(self.taken), self.k * self.nu
        X, dY = np.zeros((self.n1, m + 2 * n)), np.zeros((m, m + 2 * n))
        X[:, m : m + n] = np.array(self._shift(self.x_old, self.s0, self.p)[2])
        for w, x, u, t, h, basis, back in self.path:
            rw, rx, ru, yw, yx, yu, xw, xx, _ = (np.array(v) for v in self._slopes(w, x, u.ravel(), t, h, self.p))
            V = np.zeros((m, m + 2 * n))
            V[:, :m] = np.kron(basis, np.eye(nu))
            dw = -np.linalg.solve(rw, rx @ X + ru @ V)
            dY += np.kron(back, np.eye(nu)) @ (yw @ dw + yx @ X + yu @ V)
            X = xw @ dw + xx @ X
        _, along, direct = (np.array(v) for v in self._shift(self.x_mid, self.s1, self.p))
        X = along @ X
        X[:, m + n :] += direct
        return dY.reshape(k, nu, -1), X, np.array(self._port(self.x, self.p)[2]) @ X
