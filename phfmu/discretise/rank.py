"""Rank of the holonomic constraints at the start: which rows depend on earlier ones, and whether they contradict them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.arguments import EMPTY
from phfmu.discretise.terms import Term, Terms

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

    from phfmu.declare.phdae import PHDAE

Array = NDArray[np.float64]

TOLERANCE = 1e-9  # of rows scaled to length 1


@dataclass(frozen=True)
class Redundant:
    """A row of Dg that is sum `of`[name] * row(name) of earlier rows; `gap`: its g minus the same sum of theirs."""

    name: str
    of: dict[str, float]
    gap: float

    def __str__(self) -> str:
        terms = [f"{c:.6g} {n}" for n, c in self.of.items()]
        combination = " + ".join(terms) if terms else "0: its gradient is zero"
        return f"constraint {self.name} is redundant: Dg row = {combination}; values differ by {self.gap:.3g}"


@dataclass(frozen=True)
class ConstraintRank:
    """Rank of Dg (rows x velocities) at the start and its redundant rows, in the order of the declaration."""

    rows: int
    rank: int
    redundant: tuple[Redundant, ...]

    def report(self) -> str:
        """A line for the rank and one per redundant row."""
        return "\n".join([f"constraints: {self.rows} rows of rank {self.rank} at the start", *map(str, self.redundant)])


def constraint_rank(model: PHDAE) -> ConstraintRank:
    """Which rows of Dg(q) at the start values depend on earlier rows.  DeclarationError for a bad declaration."""
    from phfmu.discretise.extract import extract

    terms = extract(model)
    dense = constraint_jacobian(terms).toarray()
    values = constraint_values(terms)
    names = [n for v in model.algebraics for n in v.names()]
    rows = [names[t.rows[0][1]] for t in terms.terms if t.kind == "constraint"]
    kept: list[int] = []
    basis = np.zeros((0, dense.shape[1]))
    redundant = []
    for i, row in enumerate(dense):
        length = np.linalg.norm(row)
        rest = row / length if length > 0 else row
        for _ in range(2):  # twice is enough
            rest = rest - basis.T @ (basis @ rest)
        if np.linalg.norm(rest) > TOLERANCE:
            kept.append(i)
            basis = np.vstack([basis, rest / np.linalg.norm(rest)])
            continue
        c = np.linalg.lstsq(dense[kept].T, row, rcond=None)[0] if kept else np.zeros(0)
        of = {
            rows[k]: float(v) for k, v in zip(kept, c, strict=True) if abs(v) > 1e-9 * max(1.0, float(np.max(abs(c))))
        }
        redundant.append(Redundant(rows[i], of, float(values[i] - c @ values[kept])))
    return ConstraintRank(len(rows), len(kept), tuple(redundant))


def constraint_jacobian(terms: Terms) -> csc_matrix:
    """Dg at the start (constraints in order x states), on the columns of the velocities."""
    from scipy.sparse import csc_matrix

    entries = [(r, terms.velocity_of[q], value)
               for r, (t, (_, grad)) in enumerate(_evaluated(terms))
               for q, value in zip(t.index["x"], grad, strict=True)]  # fmt: skip
    row, col, value = zip(*entries, strict=True) if entries else ((), (), ())
    count = sum(t.kind == "constraint" for t in terms.terms)
    return csc_matrix((value, (row, col)), shape=(count, terms.n1))


def constraint_values(terms: Terms) -> Array:
    """g at the start, constraints in order."""
    return np.array([g for _, (g, _) in _evaluated(terms)])


def null_vectors(matrix: Array) -> Array:
    """Orthonormal columns x with matrix x = 0 (rows of the matrix are scaled to length 1 first)."""
    size = np.linalg.norm(matrix, axis=1, keepdims=True)
    _, s, right = np.linalg.svd(matrix / np.where(size > 0, size, 1.0))
    rank = int(np.sum(s > TOLERANCE))
    return right[rank:].T


def _evaluated(terms: Terms) -> list[tuple[Term, tuple[float, Array]]]:
    """Every constraint with g and grad g at the start."""
    model = terms.model
    x = np.array([s for v in model.states for s in v.start], float)
    p = np.array([s for v in model.parameters for s in v.start], float)
    known: dict[tuple, ca.Function] = {}
    out = []
    for t in terms.terms:
        if t.kind != "constraint":
            continue
        if t.key not in known:
            symbols = [t.local["x"], t.local.get("p", EMPTY), t.local.get("t", EMPTY)]
            known[t.key] = ca.Function("g", symbols, [t.data["g"], ca.densify(ca.gradient(t.data["g"], symbols[0]))])
        time = np.zeros(1 if "t" in t.local else 0)
        g, grad = known[t.key](x[list(t.index["x"])], p[list(t.index.get("p", ()))], time)
        out.append((t, (float(g), np.array(grad).ravel())))
    return out
