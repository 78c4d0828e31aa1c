"""Rules on energies: finite at the start, of the kind they claim, closed-form pairs discrete gradients.

Warnings on the form of H: terms without states, and where it is quadratic and not bounded below.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from phfmu.checks.sample import Sample
from phfmu.declare.energy import EnergyKind
from phfmu.declare.entries.entries import Entries, Entry, PairEntry
from phfmu.declare.entries.entry_kind import EntryKind
from phfmu.declare.error import Problem
from phfmu.declare.expressions.operations import piecewise
from phfmu.declare.variable import ValueKind

RELATIVE = 1e-8
SMALL = 1e-6  # increment over nominal at which a pair is compared with its limit
LIMIT = 1e-3  # allowed relative distance from the limit there


def energies(entries: Entries, sample: Sample) -> list[Problem]:
    """H and grad H are finite at the start; quadratic and strain terms are what they say."""
    terms = [(e, _states(entries, e.expr)) for e in entries.of(EntryKind.H)]
    values = sample.values([e.expr for e, _ in terms])
    gradients = sample.values([ca.gradient(e.expr, x) if x.numel() else ca.SX(0, 1) for e, x in terms])
    found = []
    for (e, x), h, g in zip(terms, values, gradients, strict=True):
        if not np.isfinite(h[0]).all():
            found.append(_start(e.label, f"H = {h[0, 0, 0]}"))
        elif not np.isfinite(g[0]).all():
            j = int(np.flatnonzero(~np.isfinite(g[0, :, 0]))[0])
            found.append(_start(e.label, f"dH/d({entries.known[x[j].element_hash()].name}) = {g[0, j, 0]}"))
    for p in entries.pairs:
        h = sample.values([ca.SX(p.origin.hamiltonian)])[0]
        if not np.isfinite(h[0]).all():
            found.append(_start(p.label, f"H = {h[0, 0, 0]}"))
    quadratic = [(e.label, e.expr, x) for e, x in terms if e.origin.kind is EnergyKind.QUADRATIC]
    found += _quadratic(entries, sample, quadratic, "H", "declare it with energy(..): its kind is recognised")
    invariants = [(e.label, e.expr, _states(entries, e.expr)) for e in entries.of(EntryKind.INVARIANT)]
    found += _quadratic(entries, sample, invariants, "C", "use energy(..), or an invariant such as a squared distance")
    return found + _strains(entries, sample)


def _states(entries: Entries, expr: ca.SX) -> ca.SX:
    return ca.vertcat(*(s for s in ca.symvar(expr) if entries.known[s.element_hash()].kind is ValueKind.STATE))


def _start(label: str, text: str) -> Problem:
    return Problem(
        "energy",
        label,
        f"{text} at the start",
        "start inside the domain of H, or write H so that it is defined there",
    )


def _quadratic(
    entries: Entries, sample: Sample, exprs: list[tuple[str, ca.SX, ca.SX]], symbol: str, remedy: str
) -> list[Problem]:
    """The Hessians of these expressions with respect to their states are constant."""
    exprs = [e for e in exprs if e[2].numel()]
    found = []
    for label, expr, x in exprs:
        if names := piecewise(expr, x):
            found.append(
                Problem(
                    "energy", label, f"{symbol} is not quadratic: it is made of pieces ({', '.join(names)})", remedy
                )
            )
    exprs = [e for e in exprs if not piecewise(e[1], e[2])]
    hessians = sample.values([ca.hessian(expr, x)[0] for _, expr, x in exprs])
    for (label, _, x), hessian in zip(exprs, hessians, strict=True):
        good = np.isfinite(hessian).all(axis=(1, 2))
        if not good.any():
            continue
        reference = hessian[good][0]
        change = np.abs(hessian[good] - reference).max(axis=0)
        if (change > RELATIVE * np.abs(hessian[good]).max()).any():
            r, c = (int(k) for k in np.unravel_index(np.argmax(change), change.shape))
            names = [entries.known[x[k].element_hash()].name for k in (r, c)]
            text = (
                f"{symbol} is not quadratic: d2{symbol}/d({names[0]})d({names[1]}) changes by "
                f"{change[r, c]:.3g} from point to point"
            )
            found.append(Problem("energy", label, text, remedy))
    return found


def _strains(entries: Entries, sample: Sample) -> list[Problem]:
    """H = phi(C) of every strain term."""
    found: list[Problem] = []
    chosen: list[tuple[Entry, ca.SX]] = []
    invariants = {id(e.origin): e for e in entries.of(EntryKind.INVARIANT)}
    for e in entries.of(EntryKind.H):
        if e.origin.kind is not EnergyKind.STRAIN:
            continue
        if e.origin.phi is None or e.origin.invariant is None:
            found.append(
                Problem(
                    "energy",
                    e.label,
                    "a strain term without invariant or phi",
                    "build it with strain_energy(C, phi)",
                )
            )
        elif id(e.origin) in invariants:
            phi = ca.SX(e.origin.phi(e.origin.invariant))
            if entries.symbols(EntryKind.H, f"phi of {e.label}", phi):
                chosen.append((e, phi))
    direct = sample.values([e.expr for e, _ in chosen])
    composed = sample.values([phi for _, phi in chosen])
    for (e, phi), a, b in zip(chosen, direct, composed, strict=True):
        size = RELATIVE * np.nanmax(np.abs(np.stack([a, b])), initial=0.0)
        excess = np.nan_to_num(np.abs(a - b) - size, nan=-1.0)
        if (excess > 0).any():
            i = int(np.argmax(excess[:, 0, 0] > 0))
            text = f"H = {a[i, 0, 0]:.9g} but phi(C) = {b[i, 0, 0]:.9g} {sample.where(i, e.expr, phi)}"
            found.append(Problem("energy", e.label, text, "build it with strain_energy(C, phi)"))
    return found


def closed_pairs(entries: Entries, sample: Sample) -> list[Problem]:
    """E^T z = grad H, zbar^T ebar = H(x + d) - H(x), and ebar -> E d, zbar -> z for small d."""
    found = []
    taken: dict[int, str] = {}
    for pair in entries.pairs:
        own = [pair.x[j].element_hash() for j in range(pair.x.numel())]
        names = {h: entries.known[h].name for h in own}
        states = ca.symvar(_states(entries, ca.SX(pair.origin.hamiltonian)))
        foreign = [s for s in states if s.element_hash() not in names]
        text = [f"H depends on '{entries.known[s.element_hash()].name}', not one of its variables" for s in foreign]
        text += [f"'{names[h]}' is in {taken[h]} as well" for h in own if h in taken]
        taken |= dict.fromkeys(own, pair.label)
        for e in entries.of(EntryKind.H, EntryKind.E):
            hashes = [s.element_hash() for s in (*ca.symvar(e.expr), *(v.sx[0] for v in e.rows))]
            text += [f"'{names[h]}' is in {e.label} as well" for h in hashes if h in names]
        if text:
            remedy = "a pair holds the whole energy and all of E of its variables, and of no others"
            found.append(Problem("closed-pair", pair.label, text[0], remedy))
        else:
            found += _pair(sample, pair)
    return found


def _pair(sample: Sample, pair: PairEntry) -> list[Problem]:
    n, p = pair.x.numel(), pair.origin
    names = [name for v in p.variables for name in v.names()]
    size = np.array([sample.size[i] for v in p.variables for i in sample.rows(v)])
    H, E, z = ca.SX(p.hamiltonian), ca.SX(p.E), ca.SX(p.z)
    remedy = "correct the closed form; see the two conditions in the description of ClosedPair"
    lhs, grad = sample.values([ca.mtimes(E.T, z), ca.gradient(H, pair.x)])
    terms = sample.values([ca.mtimes(ca.fabs(E).T, ca.fabs(z))])[0]
    text = _apart("E^T z", lhs, "grad H", grad, RELATIVE * (terms + np.abs(grad)), names)
    if text:
        return [Problem("closed-pair", pair.label, text, "correct E, z or H: E^T z = grad H")]
    if pair.ebar is None or pair.zbar is None:
        return []
    rng = np.random.default_rng(2)
    direction = rng.uniform(-1.0, 1.0, (sample.n, n)) * size
    (end,) = ca.substitute([H], [pair.x], [pair.x + pair.d])
    work = ca.dot(pair.zbar, pair.ebar)
    parts = ca.dot(ca.fabs(pair.zbar), ca.fabs(pair.ebar))
    a, b, c = sample.values([work, end - H, parts + ca.fabs(end) + ca.fabs(H)], (pair.d, 0.5 * direction))
    text = _apart("zbar^T ebar", a, "H(x + d) - H(x)", b, RELATIVE * c, ["d of half the nominal size"])
    if text:
        return [Problem("closed-pair", pair.label, text, remedy)]
    ed, terms = ca.mtimes(E, pair.d), ca.mtimes(ca.fabs(E), ca.fabs(pair.d))
    a, b, c = sample.values([pair.ebar, ed, terms], (pair.d, SMALL * direction))
    text = _apart("ebar(x, d)", a, "E d", b, LIMIT * c, names)
    a, b = sample.values([pair.zbar, z], (pair.d, SMALL * direction))
    c = np.broadcast_to(np.nanmax(np.abs(b), axis=0), b.shape)
    text = text or _apart("zbar(x, d)", a, "z", b, LIMIT * c, names)
    return [Problem("closed-pair", pair.label, f"{text} for small d", remedy)] if text else []


def _apart(left: str, a: NDArray, right: str, b: NDArray, allowed: NDArray, names: list[str]) -> str:
    """The place where two vectors per point differ by more than `allowed`, "" if nowhere or not finite."""
    excess = np.nan_to_num(np.abs(a - b) - allowed, nan=-1.0, posinf=-1.0)
    if not (excess > 0).any():
        return "" if np.isfinite(a - b).any() else f"{left} and {right} are not finite at any of the sampled points"
    i = int(np.argmax((excess > 0).any(axis=(1, 2))))
    j = int(np.argmax(excess[i, :, 0]))
    return f"{left} = {a[i, j, 0]:.9g} but {right} = {b[i, j, 0]:.9g} ({names[j]})"


NEGATIVE = 1e-9  # of the largest eigenvalue


def constants(entries: Entries, sample: Sample) -> list[Problem]:
    """Energy terms without a state: they never change and are left out."""
    return [
        Problem(
            "energy", e.label, "no state in it, so it never changes: it is left out of H",
            "remove it, or check if a state was meant", "warning",
        )
        for e in entries.of(EntryKind.H) if not _hashes(entries, e.expr, ValueKind.STATE)
    ]  # fmt: skip


def bounded(entries: Entries, sample: Sample) -> list[Problem]:
    """The constant Hessian of states that occur in quadratic terms only has no negative eigenvalue.

    In the nominal sizes of the states, at the start values of the parameters.  What other terms may hold back is not judged.
    """
    quadratic = [e for e in entries.of(EntryKind.H) if e.origin.kind is EnergyKind.QUADRATIC]
    others = [e.expr for e in entries.of(EntryKind.H) if e.origin.kind is not EnergyKind.QUADRATIC]
    others += [ca.SX(p.origin.hamiltonian) for p in entries.pairs]
    held = set().union(*(_hashes(entries, expr, ValueKind.STATE) for expr in others))
    total = ca.SX(0)
    for e in quadratic:
        total += e.expr
    x = ca.vertcat(
        *(s for s in ca.symvar(total) if s.element_hash() in _hashes(entries, total, ValueKind.STATE) - held)
    )
    if not x.numel():
        return []
    hessian = ca.hessian(total, x)[0]
    rows, columns = hessian.sparsity().get_triplet()
    entry = hessian.nz[:]
    rest = ca.symvar(entry)
    start = {
        s.element_hash(): v for q in entries.model.parameters for s, v in zip(ca.vertsplit(q.sx), q.start, strict=True)
    }
    given = [start.get(s.element_hash(), 0.0) for s in rest]
    values = ca.Function("h", [ca.vertcat(ca.SX(0, 1), *rest)], [entry])(given).full().ravel()
    size = sample.size[[sample.place[x[j].element_hash()] for j in range(x.numel())]]
    scaled = csr_matrix((values * size[rows] * size[columns], (rows, columns)), shape=hessian.shape)
    found = []
    for part in range((groups := connected_components(scaled, directed=False))[0]):
        where = np.flatnonzero(groups[1] == part)
        block = scaled[where][:, where].toarray()
        if not np.isfinite(block).all():
            continue
        value, vector = np.linalg.eigh(block)
        if value[0] < -NEGATIVE * np.abs(value).max():
            names = [entries.known[x[int(j)].element_hash()].name for j in where]
            found.append(_unbounded(entries, value[0], vector[:, 0], names, _used(entries, rest, given)))
    return found


def _unbounded(entries: Entries, value: float, vector: np.ndarray, names: list[str], parameters: str) -> Problem:
    vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
    order = [j for j in np.argsort(-np.abs(vector)) if abs(vector[j]) > 1e-6]
    along = ", ".join(f"{names[j]} = {vector[j]:.3g}" for j in order[:6]) + (", .." if len(order) > 6 else "")
    text = f"H is not bounded below: along {along} (in nominal sizes) its Hessian has the eigenvalue {value:.4g} J{parameters}"
    remedy = "energy can be drawn without end while the balance closes; correct signs or parameters"
    return Problem("bounded", entries.model.name, text, remedy, "warning")


def _used(entries: Entries, symbols: list[ca.SX], values: list[float]) -> str:
    found = [f"{entries.known[s.element_hash()].name} = {v:g}" for s, v in zip(symbols, values, strict=True)]
    return f" (with {', '.join(found[:6])}{', ..' if len(found) > 6 else ''})" if found else ""


def _hashes(entries: Entries, expr: ca.SX, kind: ValueKind) -> set[int]:
    return {s.element_hash() for s in ca.symvar(expr) if entries.known[s.element_hash()].kind is kind}
