"""Sampled points around the start at which matrices and energies are evaluated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.entries.entries import Entries, Entry
from phfmu.declare.entries.entry_kind import EntryKind
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.declare.transform.regular import undetermined
from phfmu.declare.variable import HasSymbols, Variable, key, time

Array = NDArray[np.float64]

#: the start itself, then fractions of the nominal size, drawn with a fixed seed
FRACTIONS = (0.0, 0.01, 0.1, 0.5, 0.5, 0.9)


@dataclass(frozen=True)
class Setting:
    """Values of all scalar parameters, and since when they hold in words ("" from the start)."""

    parameters: tuple[float, ...]
    since: str = ""


class Sample:
    """Points (x, z, a, u, p, t); z = E^-T grad H where that is finite, random elsewhere.

    `size` (n1): max(nominal, |start|);  `place`: row of each scalar state by its symbol.
    `known_z` (points x n1): where z was computed.  Points stay within `size` of the start, so that quantities
    whose start is not below their nominal value keep their sign.
    `settings`: parameter values at which all points are taken, one after the other (default: the start values);
    `starts`: the places of the start itself, where `time` is `t`.
    """

    def __init__(self, entries: Entries, settings: Sequence[Setting] = (), t: float = 0.0):
        model = entries.model
        self._entries = entries
        rng = np.random.default_rng(1)
        self.settings = tuple(settings) or (Setting(_parameters(model)),)
        self.n = len(FRACTIONS) * len(self.settings)
        self.starts = range(0, self.n, len(FRACTIONS))
        self._kept: dict[int, Array] = {}
        x, size = _around(model.states, rng)
        self.size, self.place = size, places(model.states)
        a, _ = _around(model.algebraics, rng)
        u = _inputs(model.ports, rng)
        z = rng.uniform(-1.0, 1.0, x.shape)
        self._symbols = [
            model.x, ca.vertcat(*(v.z for v in model.states)), ca.vertcat(*(v.sx for v in model.algebraics)),
            ca.vertcat(*(q.u for q in model.ports)), ca.vertcat(*(v.sx for v in model.parameters)),
        ]  # fmt: skip
        times = rng.uniform(0.0, 1.0, (len(FRACTIONS), 1))
        times[0] = t
        p = np.array([given.parameters for given in self.settings], float)
        points = [np.tile(v, (len(self.settings), 1)) for v in (x, z, a, u)]
        self._values = [*points, np.repeat(p, len(FRACTIONS), axis=0), np.tile(times, (len(self.settings), 1))]
        z = self.z
        self.known_z = np.zeros(z.shape, bool)
        if entries.complete:
            derived = self._costates()
            self.known_z = np.isfinite(derived)
            self._values[1] = np.where(self.known_z, derived, z)

    def rows(self, v: HasSymbols) -> range:
        """Rows of a state in x and z."""
        return range(self.place[key(v)], self.place[key(v)] + v.n)

    @property
    def x(self) -> Array:
        return self._values[0]

    @property
    def z(self) -> Array:
        return self._values[1]

    def values(self, exprs: Sequence[ca.SX], extra: tuple[ca.SX, Array] | None = None) -> list[Array]:
        """Each expression at all points (points x rows x cols); `extra`: more symbols and values."""
        if not exprs:
            return []
        symbols, given = [*self._symbols, time], list(self._values)
        if extra is not None:
            symbols.append(extra[0])
            given.append(extra[1])
        # only nonzeros: blocks of large models are sparse
        stacked = ca.vertcat(ca.SX(0, 1), *(ca.vec(e.nz[:]) for e in exprs))
        f = ca.Function("values", symbols, [stacked]).map(self.n)
        rows = np.asarray(f(*(v.T for v in given)).full()).T
        out, at = [], 0
        for e in exprs:
            value = np.zeros((self.n, *e.shape))
            r, c = e.sparsity().get_triplet()
            value[:, r, c] = rows[:, at : at + e.nnz()]
            out.append(value)
            at += e.nnz()
        return out

    def of(self, entries: Sequence[Entry]) -> list[Array]:
        """The values of these entries, evaluated once for all rules."""
        new = [e for e in entries if id(e) not in self._kept]
        self._kept |= {id(e): v for e, v in zip(new, self.values([e.expr for e in new]), strict=True)}
        return [self._kept[id(e)] for e in entries]

    def gradient(self) -> ca.SX:
        """grad H of the sound energy terms."""
        entries, model = self._entries, self._entries.model
        total = ca.SX(0)
        for e in entries.of(EntryKind.H):
            total += e.expr
        for pair in entries.pairs:
            total += pair.origin.hamiltonian
        return ca.gradient(total, model.x) if model.x.numel() else ca.SX(0, 1)

    def _costates(self) -> Array:
        """z = E^-T grad H at every point, not a number where E is singular."""
        entries = self._entries
        blocks = entries.of(EntryKind.E)
        grad, *rest = self.values([self.gradient(), *(b.expr for b in blocks), *(p.origin.z for p in entries.pairs)])
        z = grad[:, :, 0].copy()
        for b, value in zip(blocks, rest[: len(blocks)], strict=True):
            where = [i for v in b.rows for i in self.rows(v)]
            for i in range(self.n):
                z[i, where] = _solved(value[i].T, z[i, where])
        for pair, value in zip(entries.pairs, rest[len(blocks) :], strict=True):
            z[:, [i for v in pair.origin.variables for i in self.rows(v)]] = value[:, :, 0]
        return z

    def at_start(self, expr: ca.SX) -> dict[str, float]:
        """Values at the start of the variables that `expr` depends on."""
        wanted = {s.element_hash() for s in ca.symvar(expr)}
        pairs = [(symbols[j], values[0, j]) for symbols, values in zip((*self._symbols, time), self._values, strict=True)
                 for j in range(symbols.numel())]  # fmt: skip
        return {self._entries.known[s.element_hash()].name: float(v) for s, v in pairs if s.element_hash() in wanted}

    def where(self, i: int, *exprs: ca.SX) -> str:
        """The point in words: the values of some variables the expressions depend on."""
        since = self.settings[i // len(FRACTIONS)].since
        return f"{self._place(i, *exprs)}{', ' * bool(since)}{since}"

    def _place(self, i: int, *exprs: ca.SX) -> str:
        if i in self.starts:
            return "at the start"
        names, values = [], []
        for s in ca.symvar(ca.vertcat(*(ca.vec(e) for e in exprs))):
            for symbols, given in zip(self._symbols[:4], self._values[:4], strict=True):
                hashes = [symbols[j].element_hash() for j in range(symbols.numel())]
                if s.element_hash() in hashes:
                    names.append(self._entries.known[s.element_hash()].name)
                    values.append(given[i, hashes.index(s.element_hash())])
        text = ", ".join(f"{n} = {v:.4g}" for n, v in zip(names[:4], values, strict=False))
        return f"at {text}{', ..' if len(names) > 4 else ''}" if names else "at every point"


def _parameters(model: PHDAE) -> tuple[float, ...]:
    """Start values of all scalar parameters; what is not finite counts as 1."""
    return tuple(v if np.isfinite(v) else 1.0 for q in model.parameters for v in _fitted(q.start, q.n))


def _around(variables: tuple[Variable, ...], rng: np.random.Generator) -> tuple[Array, Array]:
    """Points around the starts (points x n) and the size of each; starts that are not finite count as 0."""
    start = np.array([s for v in variables for s in _fitted(v.start, v.n)], float)
    nominal = np.array([s for v in variables for s in _fitted(v.nominal, v.n)], float)
    return _points(start, nominal, rng)


def _points(start: Array, nominal: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    start = np.where(np.isfinite(start), start, 0.0)
    nominal = np.where(np.isfinite(nominal) & (nominal > 0), nominal, 1.0)
    size = np.maximum(nominal, np.abs(start))
    step = np.array(FRACTIONS)[:, None] * rng.uniform(-1.0, 1.0, (len(FRACTIONS), len(start)))
    return start + step * size, size


def _inputs(ports: tuple[Port, ...], rng: np.random.Generator) -> Array:
    start = np.array([s for p in ports for s in _spread(p.start, p.u.numel())], float)
    nominal = np.array([s for p in ports for s in _spread(p.nominal, p.u.numel())], float)
    return _points(start, nominal, rng)[0]


def _spread(value: object, n: int) -> list[float]:
    given = np.asarray(value, float).ravel()
    return [float(given[0])] * n if given.size == 1 else _fitted(given.tolist(), n)


def _fitted(values: Sequence[float], n: int) -> list[float]:
    return [*values, *[0.0] * n][:n]


def places(variables: Sequence[HasSymbols]) -> dict[int, int]:
    """Place of every scalar symbol among the stacked variables."""
    symbols = (s for v in variables for s in ca.vertsplit(v.sx))
    return {s.element_hash(): i for i, s in enumerate(symbols)}


def _solved(matrix: Array, right: Array) -> Array:
    if undetermined(matrix) >= 0:
        return np.full(len(right), np.nan)
    diagonal = np.diag(matrix)
    if np.count_nonzero(matrix) == np.count_nonzero(diagonal):
        return np.asarray(right / diagonal, np.float64)
    return np.asarray(np.linalg.solve(matrix, right), np.float64)
