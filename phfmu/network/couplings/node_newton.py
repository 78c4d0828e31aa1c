"""Newton coupling of order 2k: k_J node values per junction variable, and a pair of impulses at bare nodes.

    r_i = P^T (R* Y)_i + C xi_i,      r_e = P_b^T y1,      r_T = m' - (-1)^k_J T m,

with T m = 1/n sum_l (cos^2 t_l S1 + sin^2 t_l S0)^-1 S0 m, the rule of composed models (`schemes/impulses.py`), S0 before the
step and S1 after it.  dT/dS1 is left out of the matrix, which is that of the first trial of a step, taken anew where rows stall.

By the members' own books the junctions take W = h sum b_i xi_i.r_i + m.r_0 + m'.r_e + (m S0 m - m' S1 m')/2, r_0 being r_e before
the step; also where the iteration stops early.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import comb
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.couplings.acceptance import END, FLOOR, ITERATIONS, KNOWN, Progress
from phfmu.network.couplings.coupling import Coupling, Solution, Step, Unconverged
from phfmu.network.couplings.newton import Newton, Worst, failure
from phfmu.network.interface.exchange import Exchange
from phfmu.network.interface.joined import Joined
from phfmu.network.interface.matrices import assembled, small, update
from phfmu.outcome.status import Status, StepFailure
from phfmu.schemes.impulses import POINTS

Array = NDArray[Any]

_ANGLES = (2 * np.arange(POINTS)[:, None, None] + 1) * np.pi / (4 * POINTS)
_COS2, _SIN2 = np.cos(_ANGLES) ** 2, np.sin(_ANGLES) ** 2


@dataclass(frozen=True)
class Unknowns:
    """xi at the nodes (N), impulses m at the start and at the end of the step (2 x bare)."""

    xi: Array
    m: Array

    @property
    def flat(self) -> Array:
        """All of them (N + 2 bare)."""
        return np.concatenate([self.xi, *self.m])

    def moved(self, d: Array) -> Unknowns:
        n = len(self.xi)
        return Unknowns(self.xi + d[:n], self.m + d[n:].reshape(2, -1))


@dataclass(frozen=True)
class NodeSolution(Solution):
    """A solution with what the next step starts from: its unknowns.

    `missed`: what the continuation of the step before missed of it, that one's of the step before, and so on, as far as known.
    """

    found: Unknowns | None = None
    missed: tuple[Array, ...] = ()


def xi_at_end(exchange: Exchange | None, last: Solution) -> Array:
    """Junction unknowns at the end of the step that `last` solved."""
    return exchange.at_end(last.found.xi) if exchange and isinstance(last, NodeSolution) and last.found else last.xi


@dataclass(frozen=True)
class Before:
    """At the start of a step: S, of each cluster, and the sums of outputs of the bare columns."""

    S: list[Array]
    sums: Array


@dataclass(frozen=True)
class Trial:
    """Rows at nodes, at ends and of the impulses; their sizes; S, T of the clusters; energies left and through ports [J]."""

    rows: Array
    ends: Array
    law: Array
    size: Array
    S: list[Array]
    T: list[Array]
    left: float
    through: float

    @property
    def scaled(self) -> Array:
        return np.abs(np.concatenate([self.rows, self.ends])) / self.size


class NodeNewton:
    """As many values per junction variable and step as the members take: the whole has their order."""

    repeats, closes = True, True

    def __init__(self, exchange: Exchange):
        self.exchange = exchange
        self.order = 2 * int(exchange.counts.min(initial=exchange.counts.max(initial=1)))
        self.join()

    def join(self) -> None:
        """Takes C of the exchange, at the start and where it has changed."""
        e = self.exchange
        self._C, self._abs_C = small(e.C), small(abs(e.C))
        every = e.C.copy()
        every.resize((len(e.columns) + 2 * len(e.bare),) * 2)
        self._between = small(every)  # among rows of impulses too

    def solve(self, joined: Joined, last: Solution, step: Step) -> Solution:
        """StepFailure (no convergence, singular, not finite) names the worst junction row."""
        plain = self.start(last, step.h)
        before = last if isinstance(last, NodeSolution) and last.found is not None and last.h == step.h else None
        missed = before.missed if before else ()
        try:
            solution = self._solve(joined, plain.moved(forecast(missed)) if missed else plain, step)
        except StepFailure as refused:
            if not missed or refused.final:
                raise
            joined.restore(step.states)
            solution = self._solve(joined, plain, step)
        if before is None or solution.found is None:
            return solution
        return replace(solution, missed=(solution.found.flat - plain.flat, *missed[: KNOWN - 1]))

    def _solve(self, joined: Joined, z: Unknowns, step: Step) -> NodeSolution:
        """From the unknowns z."""
        before = self.before()
        progress, matrix = Progress(held=False), None
        best = np.inf, z
        for i in range(ITERATIONS):
            if i > 0:
                joined.restore(step.states)
            trial = self.trial(z, before, step)
            left = np.concatenate([trial.rows, trial.ends, trial.law])
            if not np.isfinite(left).all():
                raise self._failure(Status.NOT_FINITE, step, z, trial, progress.history)
            progress.note(float(np.max(trial.scaled, initial=0.0)))
            best = min(best, (progress.history[-1], z), key=itemgetter(0))
            in_play = _in_play(joined, trial) if progress.decides else 0.0
            if accepted_by := progress.accepted(partial(self._at_floor, z, trial, matrix), trial.left, in_play):
                z, trial = self._settled(z, trial, step)
                return self._solution(z, step.h, i + 1, accepted_by, self.works(z, before, trial, step.h))
            if progress.takes_matrix(trial.left, in_play):
                matrix, progress.matrices = self._matrix(trial, step), progress.matrices + 1
            try:
                z = z.moved(update(matrix, left))
            except np.linalg.LinAlgError:
                raise self._failure(Status.SINGULAR, step, z, trial, progress.history) from None
            if not np.isfinite(z.flat).all():
                raise self._failure(Status.NOT_FINITE, step, z, trial, progress.history)
        joined.restore(step.states)
        given_up = self._failure(Status.NO_CONVERGENCE, step, z, trial, progress.history)
        works = self.works(best[1], before, self.trial(best[1], before, step), step.h)
        raise given_up.of(self._solution(best[1], step.h, ITERATIONS, "", works))

    def _at_floor(self, z: Unknowns, trial: Trial, matrix: Any) -> bool:
        """Whether rows are what a relative change of the unknowns by eps makes of them; of a column, of the largest."""
        left, columns = np.abs(np.concatenate([trial.rows, trial.ends])), self.exchange.columns
        size, largest = (abs(matrix) @ np.abs(z.flat))[: len(left)], np.zeros(len(left))
        np.maximum.at(largest, columns, size[: len(columns)])
        size[: len(columns)] = largest[columns]
        return bool((left <= FLOOR * np.finfo(float).eps * size).all())

    def _settled(self, z: Unknowns, trial: Trial, step: Step) -> tuple[Unknowns, Trial]:
        """The solution of an accepted trial, with one more impulse where sums at the end exceed rounding."""
        e, n = self.exchange, len(self.exchange.columns)
        if not (np.abs(trial.ends) > END * trial.size[n:]).any():
            return z, trial
        more, ends = np.zeros(len(e.bare)), np.zeros(len(e.bare))
        for own, S in zip(e.clusters.of, trial.S, strict=True):
            more[own] = -np.linalg.solve(S, trial.ends[own])
        for s, state in zip(e.shares, step.states, strict=True):
            if not s.kicked:
                continue
            s.values.add_impulse(s.Q @ more[s.bare], step.t, step.h, state)
            ends[s.bare] += s.ends.T @ s.values.member.end_output()
        return Unknowns(z.xi, np.array([z.m[0], z.m[1] + more])), replace(trial, ends=ends)

    def start(self, last: Solution, h: float) -> Unknowns:
        """The continuation: polynomials of the step before, and its impulses if it was as long; after an event its means."""
        e = self.exchange
        nothing = np.zeros((2, len(e.bare)))
        if not isinstance(last, NodeSolution) or last.found is None or last.h == 0:
            return Unknowns(e.spread(last.xi), nothing)
        m = last.found.m if abs(h - last.h) <= 1e-9 * abs(h) else nothing
        return Unknowns(e.ahead(last.found.xi, h / last.h), m)

    def _solution(self, z: Unknowns, h: float, trials: int, accepted_by: str, works: Array) -> NodeSolution:
        e = self.exchange
        xi = e.mean(z.xi)
        xi[e.bare] += z.m.sum(axis=0) / h
        y = np.concatenate([s.values.member.output() for s in e.shares])
        return NodeSolution(xi, y, trials, accepted_by, h=h, works=works, found=z)

    def before(self) -> Before:
        """The start of a step, of the members where they are."""
        e = self.exchange
        S, sums = e.clusters.blank(), np.zeros(len(e.bare))
        for s in e.shares:
            if s.kicked:
                e.clusters.add(S, s.bare, s.Q.T @ s.values.jump() @ s.Q)
                sums[s.bare] += s.ends.T @ s.values.member.end_output()
        return Before(S, sums)

    def works(self, z: Unknowns, before: Before, trial: Trial, h: float) -> Array:
        """Energy that the junctions take of a trial [J], from rows and impulses alone: W is their sum (N + 2 bare)."""
        m, m1 = z.m
        times = self.exchange.clusters.times
        start, end = m * (before.sums + times(before.S, m) / 2), m1 * (trial.ends - times(trial.S, m1) / 2)
        return np.concatenate([h * self.exchange.weights * z.xi * trial.rows, start, end])

    def trial(self, z: Unknowns, before: Before, step: Step) -> Trial:
        """One step of all members, and what their rows leave."""
        e, h, (m, m1) = self.exchange, step.h, z.m
        rows, size, through = self._C @ z.xi, self._abs_C @ np.abs(z.xi), 0.0
        ends, end_size, S1 = np.zeros(len(e.bare)), np.zeros(len(e.bare)), e.clusters.blank()
        for s in e.shares:
            free = e.joined.free_at_nodes(s.place, s.values.rule.c, step.t, h)
            U = (s.to @ z.xi[s.own]).reshape(s.values.rule.k, -1)
            U[:, : s.place.stop - s.place.start] += free
            Y = s.values.step(U, (s.Q @ m[s.bare], s.Q @ m1[s.bare]) if s.kicked else None, step.t, h)
            rows[s.own] += s.back @ Y.ravel()
            size[s.own] += s.abs_back @ np.abs(Y.ravel())
            through += abs(h) * float(s.values.rule.b @ (np.abs(U) * np.abs(Y)).sum(axis=1))
            if s.kicked:
                y = s.values.member.end_output()
                ends[s.bare] += s.ends.T @ y
                end_size[s.bare] += s.ends.T @ np.abs(y)
                e.clusters.add(S1, s.bare, s.Q.T @ s.values.jump() @ s.Q)
        T = [_root(a, b) for a, b in zip(before.S, S1, strict=True)]
        pair = abs(e.clusters.form(before.S, m) - e.clusters.form(S1, m1)) / 2
        left = abs(h) * e.weights @ np.abs(z.xi * rows) + np.abs(m * before.sums).sum() + np.abs(m1 * ends).sum() + pair
        nominal = np.concatenate([e.row_nominal, e.joined.face.row_nominal[e.bare]])
        sizes = np.concatenate([size, end_size]) + 1e-12 * nominal
        return Trial(rows, ends, m1 - e.signs * e.clusters.times(T, m), sizes, S1, T, float(left), through)

    def _matrix(self, trial: Trial, step: Step) -> Any:
        """Derivatives of all rows with respect to (xi, m, m'), of the last trial."""
        e = self.exchange
        n, nb = len(e.columns), len(e.bare)
        parts = []
        for s, state in zip(e.shares, step.states, strict=True):
            if not s.fed:
                continue
            G, end = s.values.sensitivity(s.fed, s.kicked, step.t, step.h, state)
            inputs, (impulses, bare) = len(s.fed_rows), s.Q.shape
            to = np.zeros((G.shape[1], len(s.own) + 2 * bare))
            to[:inputs, : len(s.own)] = s.to[s.fed_rows]
            columns = s.own
            if end is not None:
                to[inputs : inputs + impulses, len(s.own) : len(s.own) + bare] = s.Q
                to[inputs + impulses :, len(s.own) + bare :] = s.Q
                columns = np.concatenate([s.own, n + s.bare, n + nb + s.bare])
                parts.append((n + s.bare, columns, s.ends.T @ end @ to))
            parts.append((s.own, columns, s.back @ G @ to[:, : len(columns)]))
        for own, T in zip(e.clusters.of, trial.T, strict=True):
            parts.append((n + nb + own, n + own, -e.signs[own, None] * T))
            parts.append((n + nb + own, n + nb + own, np.eye(len(own))))
        return assembled(self._between, parts)

    def _failure(self, status: Status, step: Step, z: Unknowns, trial: Trial, history: list[float]) -> Unconverged:
        e = self.exchange
        scaled = np.nan_to_num(trial.scaled, nan=np.inf)
        worst = int(np.argmax(scaled)) if scaled.size else 0
        n, column = len(e.columns), [*e.columns, *e.bare][worst]
        where = f" at node {e.at_node[worst] + 1}" if worst < n else " at the end of the step"
        value = float(z.xi[worst] if worst < n else e.mean(z.xi)[column])
        residual = float(abs(np.concatenate([trial.rows, trial.ends])[worst]))
        return failure(status, e.joined, step, Worst(e.names[column] + where, value, residual), history)


def forecast(missed: Sequence[Array]) -> Array:
    """The miss that a continuation will have: the polynomial through what the last ones did, the latest first."""
    n = len(missed)
    return np.sum([(-1) ** j * comb(n, j + 1) * m for j, m in enumerate(missed)], axis=0)


def _in_play(joined: Joined, trial: Trial) -> float:
    """Energy in play [J] of the trial that the members have just made."""
    return max(float(np.abs(joined.energies()).sum()), trial.through)


def _root(S0: Array, S1: Array) -> Array:
    """T of r_T."""
    if not len(S0):
        return np.zeros_like(S0)
    return (np.linalg.solve(_COS2 * S1 + _SIN2 * S0, S0[None]) / POINTS).sum(axis=0)


def newton(joined: Joined) -> Coupling:
    """The coupling with the most that the members offer; where that is one held value each, `Newton`."""
    exchange = Exchange(joined)
    return Newton() if exchange.held and not exchange.whole else NodeNewton(exchange)
