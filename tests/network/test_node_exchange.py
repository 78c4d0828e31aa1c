"""Members that exchange node values and impulses are the composed model: a small master, to prove what members offer."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Collocated,
    NativeInstance,
    Network,
    Port,
    PythonInstance,
    build_model,
    damping,
    energy,
    skew,
    state,
)
from phfmu.components.electrical.infinite_bus import infinite_bus
from phfmu.components.electrical.resistor import resistor
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.mechanical.translational import mass, spring
from phfmu.components.scenes.electrical.smib import smib
from phfmu.components.scenes.mechanical.oscillator import oscillator
from phfmu.network.interface.interface import interface
from tests.wide import wide


def quartic_on_cosh() -> Network:
    q, v, x = state("q", unit="m", start=0.4), state("v", unit="m/s", start=-0.3), state("x", unit="m", start=0.2)
    body = PHDAE(
        "body", (q, v), energies=(energy(2.0 * q.sx**2 + q.sx**4), energy(0.65 * v.sx**2)), E={v: 1.3},
        structure=(skew(q, v, 1.0),), dissipation=(damping(v, 0.2),), ports=(Port("flange", TRANSLATIONAL, "effort", {v: 1.0}),),
    )  # fmt: skip
    end = Port("end", TRANSLATIONAL, "flow", {x: 1.0})
    net = Network("nonlinear")
    net.add("body", body)
    net.add("spring", PHDAE("spring", (x,), energies=(energy(ca.cosh(1.5 * x.sx)),), ports=(end,)))
    net.connect("body.flange", "spring.end", name="joint")
    return net


def damped() -> Network:
    """Algebraic variables inside a member, feedthrough at both of its flanges."""
    net = Network("damped")
    net.add("left", mass(1.0, k=4.0, q=1.0))
    net.add("right", mass(2.0, d=0.1))
    net.add("spring", spring(30.0, d=2.0, elongation=-1.0))
    net.connect("left.flange", "spring.a", name="l")
    net.connect("right.flange", "spring.b", name="r")
    return net


def loaded() -> Network:
    """Lines with resistors of both causalities."""
    net = Network("loaded")
    net.add("grid", infinite_bus(10.0, 60.0, 0.0, i=5.0))
    net.add("one", rl_line(0.1, 1e-2, i=[1.0, -0.5, -0.5], v=10.0))
    net.add("two", rl_line(0.1, 2e-2, v=10.0))
    net.add("load", resistor(3.0, size=3, nominal=10.0))
    net.add("end", resistor(2.0, size=3, given="flow", nominal=5.0))
    net.junction("b0", ["grid.terminal", "one.a"])
    net.junction("b1", ["one.b", "two.a", "load.terminal"])
    net.junction("b2", ["two.b", "end.terminal"])
    return net


#: network, step, steps, factors on free inputs, bare junctions
CASES = {
    "oscillator": (lambda: oscillator().system, 0.02, 20, {}, ()),
    "nonlinear": (quartic_on_cosh, 0.1, 15, {}, ()),
    "damped": (damped, 0.05, 15, {}, ()),
    "loaded": (loaded, 1e-3, 10, {}, ()),
    "smib": (lambda: smib().system, 1e-3, 6, {"shaft": 1.1}, ("bus1",)),
}


class Member:
    def __init__(self, name, instance, declaration):
        self.name, self.instance = name, instance
        self.places, self.nu = {}, 0
        for p in declaration.ports:
            if p.external:
                self.places[p.name] = slice(self.nu, self.nu + p.n)
                self.nu += p.n
        self.taken = [j for p in instance.impulse_ports if p.kind == "pair" for j in p.inputs]


class Master:
    """Newton's method on k values per junction variable, and two impulses per variable of a bare junction.

    r_i = P^T Y_i + C xi_i,  r_e = P_b^T y1,  r_T = m' - (-1)^k T m with T = (S1^-1 S0)^(1/2).
    """

    def __init__(self, net, k, engine=PythonInstance, factors=(), bare=(), parts=()):
        declarations = net.members
        self.members = [Member(n, engine(build_model(d, Collocated(k))), d) for n, d in declarations.items()]
        self.parts = [dict(parts).get(m.name, 1) for m in self.members]
        self.face, self.k = interface(net, self.members), k
        self.b = self.members[0].instance.model.step.weights
        self.nx = len(self.face.names)
        self.bare = [c for j in bare for c in range(self.face.sums[j].start, self.face.sums[j].stop)]
        self.free = np.concatenate([m.instance.model.u0 for m in self.members])
        at = 0
        for m in self.members:
            for port, place in m.places.items():
                self.free[at + place.start : at + place.stop] *= dict(factors).get(port, 1.0)
            at += m.nu
        self.P, self.C = self.face.P.toarray(), self.face.C.toarray()
        self.joined = self.P.any(axis=1)
        self.free[self.joined] = 0.0
        self.z = np.concatenate([np.tile(self.face.start, k), np.zeros(2 * len(self.bare))])

    def _each(self):
        at = 0
        for m, parts in zip(self.members, self.parts, strict=True):
            yield m, self.P[at : at + m.nu], self.free[at : at + m.nu], parts
            at += m.nu

    def jumps(self):
        S = np.zeros((len(self.bare),) * 2)
        for m, P, _, _ in self._each():
            if (Q := P[m.taken][:, self.bare]).any():
                S += Q.T @ m.instance.jump() @ Q
        return S

    def sums(self):
        """Sums of the outputs at bare junctions at the present time."""
        out = np.zeros(len(self.bare))
        for m, P, _, _ in self._each():
            if P[:, self.bare].any():
                out += P[:, self.bare].T @ m.instance.signal("y_end")[: m.nu]
        return out

    def trial(self, z, t, h, states):
        """Residual of one step of all members, and the sizes of what it is a sum of."""
        k, n, nb = self.k, self.nx, len(self.bare)
        xi, m0, m1 = z[: k * n].reshape(k, n), z[k * n : k * n + nb], z[k * n + nb :]
        r, size = xi @ self.C.T, np.abs(xi) @ np.abs(self.C.T)
        for (m, P, free, parts), start in zip(self._each(), states, strict=True):
            m.instance.set_state(start)
            m.instance.set_node_inputs(xi @ P.T + free)
            if P[:, self.bare].any():
                Q = P[m.taken][:, self.bare]
                m.instance.set_impulses(Q @ m0, Q @ m1)
            m.instance.do_step(t, h, parts)
            Y = m.instance.node_output()
            r, size = r + Y @ P, size + np.abs(Y) @ np.abs(P)
        self.S1, self.rows, self.ends = self.jumps(), r, self.sums()
        root = self._root() if nb else np.zeros((0, 0))
        return np.concatenate([r.ravel(), self.ends, m1 - (-1) ** k * root @ m0]), size.ravel()

    def _root(self):
        values, W = np.linalg.eig(np.linalg.solve(self.S1, self.S0))
        return (W @ np.diag(np.sqrt(values)) @ np.linalg.inv(W)).real

    def jacobian(self):
        k, n, nb = self.k, self.nx, len(self.bare)
        J = np.zeros((k * n + 2 * nb,) * 2)
        J[: k * n, : k * n] = np.kron(np.eye(k), self.C)
        for m, P, _, _ in self._each():
            kicked = bool(P[:, self.bare].any())
            S = m.instance.node_sensitivity(impulses=kicked, end=kicked)
            width = S.nodes.shape[-1]
            to = np.zeros((width, len(J)))  # d(U, s0, s1) / dz
            to[: k * m.nu, : k * n] = np.kron(np.eye(k), P)
            if kicked:
                Q, ni = P[m.taken][:, self.bare], len(m.taken)
                to[k * m.nu : k * m.nu + ni, k * n : k * n + nb] = Q
                to[k * m.nu + ni :, k * n + nb :] = Q
                J[k * n : k * n + nb] += P[:, self.bare].T @ S.end @ to
            J[: k * n] += np.kron(np.eye(k), P.T) @ S.nodes.reshape(k * m.nu, width) @ to
        if nb:
            J[k * n + nb :, k * n : k * n + nb] = -((-1) ** k) * self._root()
            J[k * n + nb :, k * n + nb :] = np.eye(nb)
        return J

    def step(self, t, h, trials=8):
        """Trials until rows are met to rounding, `trials` at most; the last one is the step."""
        states = [m.instance.get_state() for m in self.members]
        self.S0, self.before = self.jumps(), self.sums()
        for i in range(trials):
            r, size = self.trial(self.z, t, h, states)
            self.relative = np.max(np.abs(r[: len(size)]) / (size + 1e-300), initial=0.0)
            if i == trials - 1 or (self.relative <= 1e-13 and np.abs(self.ends).max(initial=0.0) <= 1e-9):
                return i + 1
            J = self.jacobian()
            rows = 1 / np.abs(J).max(axis=1)
            self.z = self.z - np.linalg.solve(J * rows[:, None], r * rows)
        raise AssertionError

    def x(self):
        return np.concatenate([m.instance.x for m in self.members])

    def taken_by_junctions(self, h):
        """W by the theorem: from residuals and impulses alone."""
        k, n, nb = self.k, self.nx, len(self.bare)
        xi, m0, m1 = self.z[: k * n].reshape(k, n), self.z[k * n : k * n + nb], self.z[k * n + nb :]
        pair = m0 @ self.S0 @ m0 - m1 @ self.S1 @ m1
        return h * self.b @ (xi * self.rows).sum(axis=1) + m0 @ self.before + m1 @ self.ends + pair / 2

    def supplied(self):
        """The same from the members' own books, and the sum of sizes."""
        works = np.concatenate([m.instance.ledger()["pairs"][: m.nu] for m in self.members])[self.joined]
        return works.sum(), np.abs(works).sum()


def composed(case, k):
    make, h, n, factors, _ = CASES[case]
    d = make().compose()
    one = PythonInstance(build_model(d, Collocated(k)))
    u, at = one.model.u0.copy(), 0
    for p in d.ports:
        if p.external:
            u[at : at + p.n] *= factors.get(p.name.rpartition(".")[2], 1.0)
            at += p.n
    one.set_input(u)
    x = []
    for s in range(n):
        one.do_step(s * h, h)
        x.append(one.x)
    nominal = np.array([v for s in d.states for v in s.nominal])
    return np.array(x), np.maximum(np.abs(x).max(axis=0), nominal)


@pytest.mark.parametrize("k", wide([1, 2, 3], 2))
@pytest.mark.parametrize("case", wide(CASES, "nonlinear", "damped", "smib"))
def test_coupled_at_order_2k_they_are_the_composed_model(case, k):
    make, h, n, factors, bare = CASES[case]
    expected, size = composed(case, k)
    master = Master(make(), k, factors=factors, bare=bare)
    for s in range(n):
        assert master.step(s * h, h) <= 6
        assert np.max(np.abs(master.x() - expected[s]) / size) <= 1e-12
        supplied, moved = master.supplied()
        assert abs(supplied) <= 1e-12 * max(moved, sum(np.abs(m.instance.signal("H")).sum() for m in master.members))
    assert np.abs(master.ends).max(initial=0.0) <= 1e-9


def test_compiled_members_do_the_same():
    expected, size = composed("nonlinear", 2)
    make, h, n, *_ = CASES["nonlinear"]
    master = Master(make(), 2, NativeInstance)
    for s in range(n):
        assert master.step(s * h, h) <= 6
        assert np.max(np.abs(master.x() - expected[s]) / size) <= 1e-12


@pytest.mark.parametrize("k", [1, 2])
@pytest.mark.parametrize("case", wide(["nonlinear", "smib"], "nonlinear"))
@pytest.mark.parametrize("parts", [{}, {"body": 2, "spring": 3, "gen": 2, "line": 3}])
def test_of_an_iteration_stopped_early_the_junctions_take_what_the_theorem_says(case, k, parts):
    """Whatever the members do inside: the sum of their books is that of residuals and impulses."""
    make, h, _, factors, bare = CASES[case]
    master = Master(make(), k, factors=factors, bare=bare, parts=parts)
    nominal = np.concatenate([np.tile(master.face.nominal, k), np.tile(1e-2 * h * master.face.nominal[master.bare], 2)])
    for s in range(3):
        master.z = nominal * np.random.default_rng(s).normal(size=len(master.z))
        master.step(s * h, h, trials=1)
        supplied, moved = master.supplied()
        assert abs(supplied) > 1e-3 * moved
        assert master.taken_by_junctions(h) == pytest.approx(supplied, rel=1e-11)


@pytest.mark.parametrize("k", wide([2, 3]))
def test_members_with_internal_steps_of_their_own_keep_order_2k(k):
    """Against an independent solution of the joined equations; a wrong adjoint of the outputs leaves order 2 or less."""

    def rate(_, s):
        q, v, x = s
        return [v, (-(4 * q + 4 * q**3) - 0.2 * v - 1.5 * np.sinh(1.5 * x)) / 1.3, v]

    end, steps = 1.0, [0.2, 0.1, 0.05]
    exact = solve_ivp(rate, (0.0, end), [0.4, -0.3, 0.2], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    errors = []
    for h in steps:
        master = Master(quartic_on_cosh(), k, parts={"spring": 4, "body": 3})
        for s in range(round(end / h)):
            master.step(s * h, h)
        errors.append(np.max(np.abs(master.x() - exact)))
    slopes = np.diff(np.log(errors)) / np.diff(np.log(steps))
    assert slopes == pytest.approx([2 * k] * 2, abs=0.3)
