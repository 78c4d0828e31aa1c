"""Grids by phasors: the admittance matrix of a case, and the swings of machines of two axes on it.

    T_d0' Eq' = Ef - Eq - (xd - xd') i_d,   T_q0' Ed' = -Ed + (xq - xq') i_q,   v_d = Ed + xq' i_q,   v_q = Eq - xd' i_d
    delta' = w,   2 H w' = w0 (Pm - Ed i_d - Eq i_q - (xq' - xd') i_d i_q)

with constant Ef and Pm, loads as admittances, and no transients of stators and lines.  Source: P. W. Sauer and M. A. Pai, Power
System Dynamics and Stability, 1998, chapter 6.
"""

import numpy as np
from scipy.integrate import solve_ivp


def admittance(grid):
    """Buses and the admittance matrix of all that is linear but loads."""
    numbers = [b.number for b in grid.buses]
    at, Y = {n: k for k, n in enumerate(numbers)}, np.zeros((len(numbers), len(numbers)), complex)
    for b in (*grid.lines, *grid.transformers):
        if not b.on:
            continue
        i, j, y = at[b.i], at[b.j], 1.0 / complex(b.r, b.x)
        if hasattr(b, "tap"):
            t = b.tap * np.exp(1j * b.shift)
            Y[[i, j, i, j], [i, j, j, i]] += y / abs(t) ** 2 + complex(b.g, b.b), y, -y / np.conj(t), -y / t
        else:
            g1, b1, g2, b2 = b.ends
            Y[[i, j, i, j], [i, j, j, i]] += (
                y + 1j * b.b / 2 + complex(g1, b1),
                y + 1j * b.b / 2 + complex(g2, b2),
                -y,
                -y,
            )
    for s in grid.shunts:
        if s.on:
            Y[at[s.bus], at[s.bus]] += complex(s.g, s.b) / grid.base
    return numbers, Y


class Swings:
    """The machines of two axes of a grid at its buses `buses`; all quantities in per unit of the grid."""

    def __init__(self, grid, frequency=60.0):
        numbers, Y = admittance(grid)
        V = np.array([b.vm * np.exp(1j * b.va) for b in grid.buses])
        load = np.zeros(len(numbers), complex)
        for d in grid.demands:
            load[numbers.index(d.bus)] += complex(d.p, d.q) / grid.base
        self.w0, self.numbers, self.Y = 2 * np.pi * frequency, numbers, Y + np.diag(np.conj(load) / abs(V) ** 2)
        self.buses = [d.bus for d in grid.dynamics]
        self.g = np.array([numbers.index(b) for b in self.buses])
        names = ("Td10", "Tq10", "H", "xd", "xq", "xd1", "xq1")
        self.Td, self.Tq, self.H, self.xd, self.xq, self.xd1, self.xq1 = np.array(
            [[d.values[n] for n in names] for d in grid.dynamics]
        ).T
        self.one = self.Tq == 0  # no winding on the q axis
        self.xq1 = np.where(self.one, self.xq, self.xq1)
        v, i = V[self.g], np.conj((V * np.conj(Y @ V) + load)[self.g] / V[self.g])
        delta = np.angle(v + 1j * self.xq * i)
        v, i = v * np.exp(1j * (np.pi / 2 - delta)), i * np.exp(1j * (np.pi / 2 - delta))
        Eq, Ed = v.imag + self.xd1 * i.real, v.real - self.xq1 * i.imag
        self.start = np.concatenate([delta, np.zeros(len(delta)), Eq, Ed])
        self.Ef, self.Pm = Eq + (self.xd - self.xd1) * i.real, (v * np.conj(i)).real

    def after(self, bus, begin, end, times, R=1e-3):
        """Angles less their mean and less those at the start (machines x times), all `times` after a fault of R at a bus."""
        Yf = self.Y.copy()
        Yf[self.numbers.index(bus), self.numbers.index(bus)] += 1 / R
        settings = {"method": "DOP853", "rtol": 1e-9, "atol": 1e-10}
        y = solve_ivp(self._rates(Yf), (begin, end), self.start, **settings).y[:, -1]
        y = solve_ivp(self._rates(self.Y), (end, times[-1]), y, t_eval=times, **settings).y
        turned = y[: len(self.g)] - self.start[: len(self.g), None]
        return turned - turned.mean(axis=0)

    def _rates(self, Y):
        rest = np.setdiff1d(np.arange(len(Y)), self.g)
        reduced = Y[np.ix_(self.g, self.g)] - Y[np.ix_(self.g, rest)] @ np.linalg.solve(
            Y[np.ix_(rest, rest)], Y[np.ix_(rest, self.g)]
        )
        Z = np.linalg.inv(reduced)

        def rates(_, y):
            delta, w, Eq, Ed = y.reshape(4, -1)
            turn = np.exp(1j * delta)
            Zr = Z * (turn[None, :] / turn[:, None])
            M = np.block([[Zr.real, -Zr.imag - np.diag(self.xq1)], [Zr.imag + np.diag(self.xd1), Zr.real]])
            i_d, i_q = np.linalg.solve(M, np.concatenate([Ed, Eq])).reshape(2, -1)
            P = Ed * i_d + Eq * i_q + (self.xq1 - self.xd1) * i_d * i_q
            of_d = np.where(self.one, 0.0, (-Ed + (self.xq - self.xq1) * i_q) / np.where(self.one, 1.0, self.Tq))
            of_q = (self.Ef - Eq - (self.xd - self.xd1) * i_d) / self.Td
            return np.concatenate([w, self.w0 * (self.Pm - P) / (2 * self.H), of_q, of_d])

        return rates
