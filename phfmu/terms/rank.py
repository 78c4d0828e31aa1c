"""Rank of the holonomic constraints at the start: which rows depend on others, and whether they contradict them.

Constraints at rest: which of redundant rows are left out at the start.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.variable import ValueKind
from phfmu.terms.term import CONSTRAINT, Term, Terms, by_kind, gathered
from phfmu.terms.velocities import velocity_of
from phfmu.words import folded

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix, csr_matrix

    from phfmu.declare.phdae import PHDAE


Array = NDArray[np.float64]

TOLERANCE = 1e-9  # of rows scaled to length 1
SUSPECT = 1e-10  # squared distance of a row from the others below which it is looked at closely
FLOOR = 1e-14  # keeps the factor of Dg Dg^T regular


@dataclass(frozen=True)
class RedundantRow:
    """A row of Dg that is sum `of`[name] * row(name) of others that stay; `gap`: its g minus the same sum of theirs.

    It rests at the start.  `label`: what the declaration calls it.
    """

    name: str
    of: dict[str, float]
    gap: float
    label: str = ""

    @property
    def support(self) -> tuple[str, ...]:
        """Rows with a share in the null vector of Dg^T that this one has with those that stay."""
        return (self.name, *self.of)

    def __str__(self) -> str:
        terms = [f"{c:.6g} {n}" for n, c in self.of.items()]
        combination = " + ".join(terms) if terms else "0: its gradient is zero"
        label = f"; it is {self.label}" if self.label else ""
        return f"constraint {self.name} is redundant: Dg row = {combination}; values differ by {self.gap:.3g}{label}"


@dataclass(frozen=True)
class ConstraintRank:
    """Rank of Dg (rows x velocities) at the start and its redundant rows, in the order of the declaration.

    `groups`: (rows that depend on each other, how many of them are too many);  `unique`: rows with no share in any null
    vector of Dg^T, whose forces are determined.
    """

    rows: int
    rank: int
    redundant: tuple[RedundantRow, ...]
    groups: tuple[tuple[tuple[str, ...], int], ...] = ()
    unique: tuple[str, ...] = ()

    def report(self) -> str:
        """Lines for the rank, for each group of dependent rows and for each redundant row."""
        lines = [f"constraints: {self.rows} rows of rank {self.rank} at the start"]
        lines += [
            f"{many} of these {'is' if many == 1 else 'are'} too many: {', '.join(names)}"
            for names, many in self.groups
        ]
        if self.groups:
            text = (
                "the motion does not depend on which rests; their forces are not unique, those of least norm are given"
            )
            lines += [text, f"unique forces: {folded(self.unique) or 'none'}"]
        return "\n".join([*lines, *map(str, self.redundant)])


def constraint_rank(model: PHDAE) -> ConstraintRank:
    """The rows of Dg(q) at the start values that depend on others.  A bad declaration raises DeclarationError."""
    from phfmu.terms.extraction.extract import extract

    terms = extract(model)
    jacobian, values = constraint_jacobian(terms), constraint_values(terms)
    names = [n for v in model.algebraics for n in v.names()]
    rows = [names[t.rows[0].index] for t in terms.of(CONSTRAINT)]
    labels = constraint_labels(model)
    redundant: dict[int, RedundantRow] = {}
    groups = []
    for d in dependences(jacobian, kept_rows(terms)):
        kept = [i for i in d.rows if i not in d.resting]
        for r in d.resting:
            row = jacobian[r].toarray().ravel()
            c = np.linalg.lstsq(jacobian[kept].toarray().T, row, rcond=None)[0] if kept else np.zeros(0)
            most = max(1.0, float(np.max(abs(c), initial=0.0)))
            of = {rows[k]: float(v) for k, v in zip(kept, c, strict=True) if abs(v) > 1e-9 * most}
            redundant[r] = RedundantRow(rows[r], of, float(values[r] - c @ values[kept]), labels.get(rows[r], ""))
        groups.append((tuple(rows[i] for i in d.rows), len(d.resting)))
    found = tuple(redundant[r] for r in sorted(redundant))
    shared = {n for names, _ in groups for n in names}
    unique = tuple(n for n in rows if n not in shared)
    return ConstraintRank(len(rows), len(rows) - len(found), found, tuple(groups), unique)


def constraint_labels(model: PHDAE) -> dict[str, str]:
    """Multiplier -> name of its constraint in the declaration, where it has one."""
    return {n: c.label for c in model.constraints if c.label for n in c.multiplier.names()}


@dataclass(frozen=True)
class Dependence:
    """Rows that depend on each other, and those of them that rest: without these the others are independent."""

    rows: tuple[int, ...]
    resting: tuple[int, ...]


def kept_rows(terms: Terms) -> NDArray[np.bool_]:
    """Mask of the constraints, in order, that rest only where no others can."""
    names = [n for v in terms.model.algebraics for n in v.names()]
    kept = {n for c in terms.model.constraints if c.kept for n in c.multiplier.names()}
    return np.array([names[t.rows[0].index] in kept for t in terms.of(CONSTRAINT)], bool)


def dependences(jacobian: csc_matrix, kept: NDArray[np.bool_]) -> list[Dependence]:
    """Groups of rows with common null vectors of Dg^T, each row in one group at most.

    A sparse factor of Dg Dg^T finds candidates; the null vectors Y of their surroundings, from rows of length 1, tell.  QR of
    Y^T with pivoting chooses the rows with the largest shares to rest: the others are then as well conditioned as
    they can be.  Of equal ones the last rests; those `kept` only where no others can.
    """
    from scipy.sparse import csr_matrix, diags

    size = np.sqrt(np.asarray(jacobian.multiply(jacobian).sum(axis=1)).ravel())
    scaled = csr_matrix(diags(1.0 / np.where(size > 0, size, 1.0)) @ jacobian)
    found = []
    for rows in _suspects(scaled):
        left, s, _ = np.linalg.svd(scaled[rows].toarray())
        null = left[:, int(np.sum(s > TOLERANCE)) :]
        shares = np.linalg.norm(null, axis=1)
        found += [_chosen(np.array(rows)[part], null[part], kept) for part in _together(null, shares)]
    return found


def _suspects(scaled: csr_matrix) -> list[list[int]]:
    """Groups of rows that may depend on each other, each with all rows its null vectors can touch; mostly none."""
    from scipy.sparse import csc_matrix, identity
    from scipy.sparse.csgraph import connected_components
    from scipy.sparse.linalg import splu

    gram = csc_matrix(scaled @ scaled.T)
    lu = splu(csc_matrix(gram + FLOOR * identity(len(gram.indptr) - 1)), diag_pivot_thresh=0.0,
              permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})  # fmt: skip
    weak = np.abs(lu.U.diagonal())[lu.perm_c] < SUSPECT
    if not weak.any():
        return []
    kept, left = np.flatnonzero(~weak), np.flatnonzero(weak)
    shares = (
        splu(csc_matrix(gram[kept][:, kept])).solve(gram[kept][:, left].toarray())
        if len(kept)
        else np.zeros((0, len(left)))
    )
    touched = np.zeros((len(weak), len(left)), bool)
    touched[kept] = np.abs(shares) > 1e-6
    touched[left, np.arange(len(left))] = True
    links = csc_matrix(touched.astype(float))
    _, label = connected_components(links @ links.T, directed=False)
    return [np.flatnonzero(label == g).tolist() for g in np.unique(label[left])]


def _together(null: Array, shares: Array) -> list[NDArray[np.intp]]:
    """Rows with a share in some null vector, by groups without common null vectors."""
    from scipy.sparse import csc_matrix
    from scipy.sparse.csgraph import connected_components

    projector = np.abs(null @ null.T) > TOLERANCE
    _, label = connected_components(csc_matrix(projector), directed=False)
    return [np.flatnonzero(label == g) for g in np.unique(label[shares > TOLERANCE])]


def _chosen(rows: NDArray[np.int64], null: Array, kept: NDArray[np.bool_]) -> Dependence:
    from scipy.linalg import qr

    many = int(round(float(np.sum(null**2))))  # trace of the projector on their null vectors
    prefer = (1.0 + 1e-6 * np.arange(len(rows)) / len(rows)) * np.where(kept[rows], 1e-6, 1.0)
    order = qr((null * prefer[:, None]).T, mode="economic", pivoting=True)[-1]
    return Dependence(tuple(rows.tolist()), tuple(sorted(rows[order[:many]].tolist())))


def constraint_jacobian(terms: Terms) -> csc_matrix:
    """Dg at the start (constraints in order x states), on the columns of the velocities."""
    from scipy.sparse import csc_matrix

    velocity = velocity_of(terms)
    entries = [(r, velocity[q], value)
               for r, (t, (_, grad)) in enumerate(_evaluated(terms))
               for q, value in zip(t.index[ValueKind.STATE], grad, strict=True)]  # fmt: skip
    row, col, value = zip(*entries, strict=True) if entries else ((), (), ())
    count = len(terms.of(CONSTRAINT))
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
    found: dict[int, tuple[float, Array]] = {}
    for own in by_kind(terms.of(CONSTRAINT)):
        t = own[0]
        symbols = [t.local[ValueKind.STATE], t.symbols(ValueKind.PARAMETER), t.symbols(ValueKind.TIME)]
        f = ca.Function("g", symbols, [t.data["g"], ca.densify(ca.gradient(t.data["g"], symbols[0]))])
        time = np.zeros((symbols[2].numel(), len(own)))
        values = f(gathered(x, own, ValueKind.STATE), gathered(p, own, ValueKind.PARAMETER), time)
        g, grad = (np.array(v.full()) for v in values)
        found |= {id(t): (float(g[0, i]), grad[:, i].copy()) for i, t in enumerate(own)}
    return [(t, found[id(t)]) for t in terms.of(CONSTRAINT)]


@dataclass(frozen=True)
class ConstraintsAtStart:
    """Holonomic constraints at the start: multiplier -> natural size of Dg v;  multipliers of those that rest."""

    sizes: dict[int, float] = field(default_factory=dict)
    resting: frozenset[int] = frozenset()


def at_start(terms: Terms) -> Terms:
    """The terms with the facts about their constraints at the start: sizes, and those that rest."""
    owner = [t.rows[0].index for t in terms.of(CONSTRAINT)]
    if not owner:
        return terms
    states = terms.model.states
    moving = [max(n, abs(s)) for v in states for n, s in zip(v.nominal, v.start, strict=True)]
    jacobian = constraint_jacobian(terms)
    sizes = abs(jacobian) @ np.array(moving)
    sizes[sizes == 0.0] = np.max(sizes, initial=0.0) or 1.0  # no gradient here, perhaps later
    rests = [owner[i] for d in dependences(jacobian, kept_rows(terms)) for i in d.resting]
    return terms.having(ConstraintsAtStart(dict(zip(owner, sizes.tolist(), strict=True)), frozenset(rests)))


def hold_names(terms: Terms) -> tuple[str, ...]:
    """The constraints in order: multiplier, and name in the declaration."""
    labels = constraint_labels(terms.model)
    own = [terms.algebraic_names[a] for a in terms.found(ConstraintsAtStart).sizes]
    return tuple(f"{n} ({labels[n]})" if n in labels else n for n in own)
