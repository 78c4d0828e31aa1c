"""Rules on energies in pieces: H must be continuous; what a kink means for the order."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.checks.sample import Sample, Setting
from phfmu.declare.entries.entries import Entries
from phfmu.declare.entries.entry_kind import EntryKind
from phfmu.declare.error import Problem
from phfmu.declare.expressions.operations import analytic, piecewise, switches
from phfmu.declare.variable import ValueKind

POINTS = 129  # of a line on which pieces are looked for
REACH = 3.0  # half its length, in sizes of the states
HALVINGS = 60  # of an interval in which a piece ends
JUMP = 1e-7  # of the largest value on the line


@dataclass(frozen=True)
class _Seam:
    """A place where two pieces meet: the states there in words, the jump of H in joule, and whether its gradient jumps."""

    where: str
    jump: float
    bends: bool


@dataclass(frozen=True)
class _Pieces:
    label: str
    operations: tuple[str, ...]
    seams: list[_Seam]


def continuous(entries: Entries, sample: Sample) -> list[Problem]:
    """H does not jump where its pieces meet."""
    return [
        Problem(
            "energy", p.label, f"H jumps by {s.jump:.3g} J at {s.where} ({', '.join(p.operations)})",
            "H must be continuous, for no force does the work of a jump: let the pieces meet, or let an event make the change",
        )
        for p in _found(entries, sample) for s in p.seams[:1] if s.jump
    ]  # fmt: skip


def kinks(entries: Entries, sample: Sample) -> list[Problem]:
    """Warnings: the order is lower on steps over a kink."""
    found = []
    for p in _found(entries, sample):
        bends = [s for s in p.seams if s.bends]
        names = ", ".join(p.operations)
        if bends:
            text = f"H has a kink ({names}), its gradient jumps at {bends[0].where}: steps over it limit the order to 2"
        elif p.seams:
            text = f"H is made of pieces ({names}) that meet smoothly at {p.seams[0].where}: steps over it limit the order to 3"
        else:
            text = f"H is made of pieces ({names}): steps from one to the next limit the order to 2 or 3"
        remedy = "the balance is exact; use smaller steps, or an event there, where more accuracy is wanted"
        found.append(Problem("kink", p.label, text, remedy, "warning"))
    return found


def _found(entries: Entries, sample: Sample) -> list[_Pieces]:
    named = [(e.label, e.expr) for e in entries.of(EntryKind.H)]
    named += [(p.label, ca.SX(p.origin.hamiltonian)) for p in entries.pairs]
    if analytic([expr for _, expr in named]):
        return []
    out = []
    for label, expr in named:
        x = ca.vertcat(*(s for s in ca.symvar(expr) if entries.known[s.element_hash()].kind is ValueKind.STATE))
        names = piecewise(expr, x) if x.numel() else ()
        if names:
            settings = sample.settings if ca.depends_on(expr, _parameters(entries)) else sample.settings[:1]
            seams = [seam for s in settings for seam in _seams(entries, sample, expr, x, s)]
            out.append(_Pieces(label, names, sorted(seams, key=lambda s: (-abs(s.jump), not s.bends))))
    return out


def _parameters(entries: Entries) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *(v.sx for v in entries.model.parameters))


def _seams(entries: Entries, sample: Sample, expr: ca.SX, x: ca.SX, setting: Setting) -> list[_Seam]:
    """The places where pieces meet on lines through the start, with the parameters of `setting`."""
    p, values = _parameters(entries), np.array(setting.parameters)
    since = f", {setting.since}" * bool(setting.since)
    both = ca.vertcat(expr, ca.gradient(expr, x))
    f, piece = (ca.Function("f", [x, p], [ca.densify(e)]) for e in (both, switches(expr, x)))
    at = [sample.place[x[j].element_hash()] for j in range(x.numel())]
    start, size = sample.x[0, at], sample.size[at]
    along = np.linspace(-REACH, REACH, POINTS) * (1 + 1e-9)
    rng, out = np.random.default_rng(3), []
    for direction in [*np.eye(len(at))[:8], *rng.uniform(-1, 1, (4, len(at)))]:
        line = start[:, None] + (direction * size)[:, None] * along
        codes, all_values = (np.array(g(line, np.tile(values[:, None], (1, POINTS)))) for g in (piece, f))
        scale = np.nanmax(np.abs(np.where(np.isfinite(all_values), all_values, np.nan)), axis=1, initial=0.0)
        for i in np.flatnonzero((codes[:, 1:] != codes[:, :-1]).any(axis=0))[:4]:
            ends = _halved(piece, values, line[:, i], line[:, i + 1])
            a, b = (np.array(f(e, values)).ravel() for e in ends)
            apart = np.abs(b - a) > JUMP * scale
            names = ", ".join(f"{entries.known[x[j].element_hash()].name} = {v:.4g}" for j, v in enumerate(ends[1][:4]))
            out.append(_Seam(names + since, float(b[0] - a[0]) if apart[0] else 0.0, bool(apart[1:].any())))
    return out


def _halved(piece: ca.Function, p: NDArray, a: NDArray, b: NDArray) -> tuple[NDArray, NDArray]:
    """Two points next to each other on both sides of a seam between a and b."""
    here = np.array(piece(a, p))
    for _ in range(HALVINGS):
        middle = (a + b) / 2
        a, b = (middle, b) if (np.array(piece(middle, p)) == here).all() else (a, middle)
    return a, b
