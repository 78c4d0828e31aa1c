"""Rules on matrices at sampled points: J skew, R symmetric and semidefinite, E regular, given z right.

Where R is not positive semidefinite in a given state: what a negative dissipation comes from.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.checks.sample import Sample, places
from phfmu.declare.entries.entries import Entries, Entry, normal_form
from phfmu.declare.entries.entry_kind import EntryKind
from phfmu.declare.error import Problem
from phfmu.declare.phdae import PHDAE
from phfmu.declare.transform.regular import undetermined
from phfmu.declare.variable import ValueKind, key

RELATIVE = 1e-9  # of the numbers compared
FLOOR = 1e-12  # of the largest entry of a block: rounding of entries that cancel to zero


def finite(entries: Entries, sample: Sample) -> list[Problem]:
    """Matrices are finite at the start; with algebraic variables, whose start is only a guess, somewhere."""
    chosen = entries.of(EntryKind.J, EntryKind.R, EntryKind.B, EntryKind.E, EntryKind.COSTATE, EntryKind.SOURCE)
    found = []
    for e, value in zip(chosen, sample.of(chosen), strict=True):
        bad = ~np.isfinite(value)
        kinds = {entries.known[s.element_hash()].kind for s in ca.symvar(e.expr)}
        exact = ValueKind.ALGEBRAIC not in kinds and (ValueKind.COSTATE not in kinds or sample.known_z[0].all())
        first = next((i for i in sample.starts if bad[i].any()), -1)
        if (exact and first >= 0) or bad.any(axis=(1, 2)).all():
            i = max(first, 0)
            r, c = np.argwhere(bad[i] if first >= 0 else bad[1])[0]
            text = sample.where(i) if first >= 0 else "at any of the sampled points"
            found.append(
                Problem("start", e.label, f"entry [{r + 1}, {c + 1}] is {value[i, r, c]} {text}",
                        "start where it is defined, or write it so that it is defined there")
            )  # fmt: skip
    return found


def skew_symmetry(entries: Entries, sample: Sample) -> list[Problem]:
    """J + J^T = 0 per block."""
    return _mirrored(
        entries, sample, EntryKind.J, +1, "skew", "build it with skew(rows, cols, matrix), or correct the sign"
    )


def symmetry(entries: Entries, sample: Sample) -> list[Problem]:
    """R = R^T per block."""
    remedy = "make the block symmetric; a skew part belongs into J"
    return _mirrored(entries, sample, EntryKind.R, -1, "symmetry", remedy)


def _mirrored(entries: Entries, sample: Sample, what: EntryKind, sign: int, rule: str, remedy: str) -> list[Problem]:
    blocks, found = entries.of(what), []
    for e, value in zip(blocks, sample.of(blocks), strict=True):
        good = np.isfinite(value)
        value = np.where(good & good.transpose(0, 2, 1), value, 0.0)
        mirror = value.transpose(0, 2, 1)
        size = (np.abs(value) + np.abs(mirror)).max(axis=0)
        excess = np.abs(value + sign * mirror) - RELATIVE * size - FLOOR * size.max(initial=0.0)
        if not (excess > 0).any():
            continue
        i = int(np.argmax((excess > 0).any(axis=(1, 2))))
        r, c = sorted(int(k) for k in np.unravel_index(np.argmax(excess[i]), excess[i].shape))
        names, n = e.names(), int(np.count_nonzero((excess > 0).any(axis=0)[np.triu_indices(len(size))]))
        more = f" ({n} such entries)" if n > 1 else ""
        found.append(
            Problem(
                rule, e.label,
                f"{what}[{names[r]}, {names[c]}] = {value[i, r, c]:.6g} but {what}[{names[c]}, {names[r]}] = "
                f"{value[i, c, r]:.6g}, {'sum' if sign > 0 else 'difference'} "
                f"{value[i, r, c] + sign * value[i, c, r]:.3g} {sample.where(i, e.expr)}{more}",
                remedy,
            )
        )  # fmt: skip
    return found


def passivity(entries: Entries, sample: Sample) -> list[Problem]:
    """The sum W of all R blocks on variables and ports is positive semidefinite."""
    found = []
    for blocks, names, total in summed(entries, sample):
        text = _indefinite(total, names, blocks, sample)
        if text:
            label = "; ".join(dict.fromkeys(b.label for b in blocks))
            remedy = "dissipation must not create energy: correct its sign or coupling, or feed it by a port"
            found.append(Problem("passivity", label, text, remedy))
    return found


def summed(entries: Entries, sample: Sample) -> Iterator[tuple[list[Entry], list[str], NDArray]]:
    """Per group of blocks of R that share rows: the blocks, the names of the rows, and W there (points x n x n)."""
    variables = (*entries.model.states, *entries.model.algebraics, *entries.model.ports)
    names = [n for v in variables for n in v.names()]
    place = places(variables)
    blocks = entries.of(EntryKind.R)
    rows = [[place[key(v)] + j for v in e.rows for j in range(v.n)] for e in blocks]
    values = sample.of(blocks)
    for group in _connected(rows, len(names)):
        where = sorted({i for b in group for i in rows[b]})
        local = {i: j for j, i in enumerate(where)}
        total = np.zeros((sample.n, len(where), len(where)))
        for b in group:
            index = [local[i] for i in rows[b]]
            for r, i in enumerate(index):
                for c, j in enumerate(index):
                    total[:, i, j] += values[b][:, r, c]
        yield [blocks[b] for b in group], [names[i] for i in where], total


def _connected(sets: list[list[int]], n: int) -> list[list[int]]:
    """Groups of sets that share elements of range(n), directly or through others."""
    if not sets:
        return []
    pairs = [(b, len(sets) + i) for b, s in enumerate(sets) for i in s]
    row, col = [b for b, _ in pairs], [i for _, i in pairs]
    # the strong components of a symmetric pattern are its connected ones
    count, order, first = ca.Sparsity.triplet(len(sets) + n, len(sets) + n, row + col, col + row).scc()
    parts = (order[first[k] : first[k + 1]] for k in range(count))
    return sorted(sorted(b for b in part if b < len(sets)) for part in parts if any(b < len(sets) for b in part))


def _indefinite(total: NDArray, names: list[str], blocks: list[Entry], sample: Sample) -> str:
    """The defect of R (points x n x n), "" if it is positive semidefinite at every finite point."""
    worst, text = 0.0, ""
    for i, R in enumerate(total):
        size, value, direction = lowest(R)
        if size < worst:
            worst = size
            shown = ", ".join(names[:6]) + (", .." if len(names) > 6 else "")
            text = (
                f"the summed R on ({shown}) has the eigenvalue {value:.6g}, mostly along "
                f"'{names[direction]}', {sample.where(i, *(b.expr for b in blocks))}"
            )
    return text


def lowest(R: NDArray) -> tuple[float, float, int]:
    """The lowest eigenvalue of R with balanced rows, of R itself, and the row its direction is closest to; 0 if none is
    negative or R is not finite."""
    if not np.isfinite(R).all():
        return 0.0, 0.0, 0
    R = (R + R.T) / 2
    diagonal = np.abs(np.diag(R))
    size = np.sqrt(np.where(diagonal > 0, diagonal, np.abs(R).max(axis=1)))
    size[size == 0] = 1.0
    # a congruence keeps the signs of the eigenvalues and makes units comparable
    balanced, vectors = np.linalg.eigh(R / np.outer(size, size))
    if not balanced[0] < -RELATIVE * max(balanced[-1], 1.0):
        return 0.0, 0.0, 0
    plain = np.linalg.eigvalsh(R)[0]
    return balanced[0], plain if plain < 0 else balanced[0], int(np.argmax(np.abs(vectors[:, 0])))


def masses(entries: Entries, sample: Sample) -> list[Problem]:
    """E11 is regular at the start and at sampled points; massless velocities are left to the constraints.

    E of a pair (E, z) may be singular.
    """
    chosen = [(e.label, e.expr, e.names()) for e in entries.of(EntryKind.E)]
    found = []
    for (label, expr, names), value in zip(chosen, sample.values([c[1] for c in chosen]), strict=True):
        for i, E in enumerate(value):
            row = undetermined(E) if np.isfinite(E).all() else -1
            if (
                row >= 0
                and entries.of(EntryKind.CONSTRAINT)
                and expr.sparsity().is_diag()
                and expr[row, row].is_symbolic()
            ):
                break  # z = v whatever the parameter m: the constraints decide
            if row >= 0:
                text = f"E[{names[row]}, {names[row]}] = {E[row, row]:g}, singular {sample.where(i, expr)}"
                found.append(
                    Problem(
                        "mass",
                        label,
                        text,
                        _remedy(entries, expr, names[row]),
                    )
                )
                break
    return found


def _remedy(entries: Entries, E: ca.SX, name: str) -> str:
    states = any(entries.known[s.element_hash()].kind is ValueKind.STATE for s in ca.symvar(E))
    if states:
        return "start elsewhere; for E of constant rank declare the form of `Parametrised`"
    if E.sparsity().is_diag():
        return f"give a nonzero mass, or make '{name}' an algebraic variable"
    return "give a regular E, or give z of its variables and use reduce_descriptor(model)"


def costates(entries: Entries, sample: Sample) -> list[Problem]:
    """A given z equals E^-T grad H; where E is singular, E^T z = grad H."""
    if not entries.complete:
        return []
    return _derived(entries, sample) + _descriptor(entries, sample)


def _descriptor(entries: Entries, sample: Sample) -> list[Problem]:
    """E^T z = grad H for the blocks of E that are singular at the start."""
    given, grad, found = {id(e.rows[0]): e.expr for e in entries.of(EntryKind.COSTATE)}, sample.gradient(), []
    for e in entries.of(EntryKind.E):
        span = [i for v in e.rows for i in sample.rows(v)]
        if sample.known_z[0, span].all() or any(id(v) not in given for v in e.rows):
            continue
        z = ca.vertcat(*(given[id(v)] for v in e.rows))
        left, right = ca.mtimes(e.expr.T, z), grad[span]
        parts = ca.mtimes(ca.fabs(e.expr).T, ca.fabs(z)) + ca.fabs(right)
        a, b, size = (value[:, :, 0] for value in sample.values([left, right, parts]))
        excess = np.nan_to_num(np.abs(a - b) - 10 * RELATIVE * size, nan=-1.0)
        if (excess > 0).any():
            i = int(np.argmax((excess > 0).any(axis=1)))
            j = int(np.argmax(excess[i]))
            text = f"{e.names()[j]}: E^T z = {a[i, j]:.9g}, grad H = {b[i, j]:.9g} {sample.where(i, left, right)}"
            found.append(Problem("costate", e.label, text, "correct z, H or E"))
    return found


def _derived(entries: Entries, sample: Sample) -> list[Problem]:
    chosen, found = entries.of(EntryKind.COSTATE), []
    for e, value in zip(chosen, sample.of(chosen), strict=True):
        span = list(sample.rows(e.rows[0]))
        given, derived = value[:, :, 0], np.where(sample.known_z[:, span], sample.z[:, span], np.nan)
        size = np.nanmax(np.abs(np.stack([given, derived])), axis=(0, 1), initial=0.0)
        excess = np.nan_to_num(np.abs(given - derived) - 10 * RELATIVE * size, nan=-1.0)
        if (excess > 0).any():
            i = int(np.argmax((excess > 0).any(axis=1)))
            j = int(np.argmax(excess[i]))
            found.append(
                Problem(
                    "costate", e.label,
                    f"{e.names()[j]}: given z = {given[i, j]:.9g}, E^-T grad H = {derived[i, j]:.9g} "
                    f"{sample.where(i, e.expr, sample.gradient()[span[j]])}",
                    "correct z or H, or leave z out: it is derived from H and E",
                )
            )  # fmt: skip
    return found


@dataclass(frozen=True)
class IndefiniteBlock:
    """A group of blocks of R that share rows: its owner, entries and rows, its lowest eigenvalue, the row closest to the
    direction of that, and the values the blocks depend on."""

    owner: str
    entry: str
    rows: tuple[str, ...]
    eigenvalue: float
    along: str
    values: Mapping[str, float]

    def __str__(self) -> str:
        text = f"{self.entry} has the eigenvalue {self.eigenvalue:.6g}, mostly along '{self.along}'"
        shown = [f"{name} = {value:.6g}" for name, value in list(self.values.items())[:6]]
        return f"{text}, at {', '.join(shown)}" if shown else text


def sign_lost(
    model: PHDAE, values: Mapping[str, float], t: float = 0.0, owner: str | None = None
) -> list[IndefiniteBlock]:
    """The groups of R (of one `owner`) with a negative eigenvalue at time t; the lowest first.

    `values`: by scalar name those of states, algebraic variables, inputs and parameters that are not as declared; names the
    model does not have are skipped.
    """
    known = {*(n for v in (*model.states, *model.algebraics, *model.parameters) for n in (v.name, *v.names()))}
    known |= {n for p in model.ports for n in p.input_names()}
    entries = Entries(model.with_starts({n: float(v) for n, v in values.items() if n in known}))
    normal_form(entries)
    sample = Sample(entries, t=t)
    found = []
    for blocks, names, total in summed(entries, sample):
        owners = {b.origin.owner for b in blocks}
        _, value, direction = lowest(total[0])
        if not value or (owner is not None and owner not in owners):
            continue
        label = "; ".join(dict.fromkeys(b.label for b in blocks))
        at = sample.at_start(ca.vertcat(*(ca.vec(b.expr) for b in blocks)))
        found.append(IndefiniteBlock(min(owners), label, tuple(names), float(value), names[direction], at))
    return sorted(found, key=lambda s: s.eigenvalue)
