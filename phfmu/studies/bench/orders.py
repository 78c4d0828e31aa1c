"""Observed orders and worst ledger closure of all schemes on everything in the library: `phfmu bench orders`.

Every target runs from its start with constant inputs over a time in which it moves visibly.  Steps are halved until the
slope of the error settles; the reference is the scheme of order 6 with ORDER_6 steps.  A scheme that does not fit a target
gives the reason as a word.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE
from phfmu.discretise.model import Model, build_model
from phfmu.engine.reference.python import PythonInstance
from phfmu.gradients.gradient_names import GRADIENTS
from phfmu.outcome.status import StepFailure
from phfmu.outcome.steps import balance
from phfmu.schemes.named import named_scheme
from phfmu.schemes.scheme_names import ORDERS, SCHEMES
from phfmu.studies.tables import markdown_table

Array = NDArray[np.float64]

COUNTS = (6, 12, 24, 48, 96)  # steps to the end of the run; states are compared at the COUNTS[0] times all share
COARSE = 1e-6
SHORTEST, LONGEST = 1e-5, 100.0  # s, of runs
ORDER_6 = 132  # steps of the reference
FLOOR = 1e-11  # relative errors below are rounding
SETTLED = 0.03  # change of the slope from halving to halving
LARGEST = 40  # states; larger models repeat what smaller ones show
#: the rule of a DeclarationError -> the word in the table
REASONS = {
    "constraint": "no constraint", "drift": "g drifts", "stages": "odd k", "order": "order 2", "pair": "order 2",
    "gradient": "order 2", "descriptor": "diagonal E", "velocity": "velocities", "singular": "singular", "mass": "no mass",
}  # fmt: skip


@dataclass(frozen=True)
class Method:
    """A column: scheme, order and gradient as users say them."""

    scheme: str
    order: int
    gradient: str = "per-term"

    def __str__(self) -> str:
        name = self.scheme if self.gradient == "per-term" else self.gradient
        return f"{name} {self.order}"


@dataclass
class OrderRow:
    """Cells of one target: a slope or a word per method, and the worst ledger closure per method."""

    target: str
    cells: dict[Method, str] = field(default_factory=dict)
    ledger: dict[Method, float] = field(default_factory=dict)


def methods() -> list[Method]:
    """Every scheme with the default gradient in every order, every other gradient with the default scheme."""
    out = [Method(s, k) for s in SCHEMES if s != "auto" for k in ORDERS if k % 2 == (s == "radau")]
    return out + [Method("auto", k, g) for g in GRADIENTS if g != "per-term" for k in ORDERS if k % 2 == 0]


def targets(names: Sequence[str] = ()) -> Iterator[tuple[str, PHDAE]]:
    """Components and scenes of the library that have 1 to LARGEST states and no state events, or those named.

    ValueError for one that is named and has no states, or state events.
    """
    from phfmu.components.library import LIBRARY, build

    for name in names or LIBRARY:
        found = build(name)
        declaration = found if isinstance(found, PHDAE) else found.declaration()
        states, events = sum(v.n for v in declaration.states), declaration.state_events or declaration.switches
        if names and (states == 0 or events):
            raise ValueError(f"{name} has {'state events' if events else 'no states'}: no order of it is measured")
        if states and not events and (names or states <= LARGEST):
            yield name, declaration


def measure(names: Sequence[str] = (), report: Callable[[str], None] = lambda text: None) -> list[OrderRow]:
    """Rows of the targets; `report` is told what is being measured.  KeyError for a name the library does not have."""
    rows = []
    for name, declaration in targets(names):
        report(name)
        rows.append(_row(name, declaration))
    return rows


def _row(name: str, declaration: PHDAE) -> OrderRow:
    row = OrderRow(name)
    best = build_model(declaration, named_scheme(declaration, order=6))
    stop = span(best)
    truth, _ = trajectory(best, stop, ORDER_6)
    scale = _scale(best, truth)
    for method in methods():
        holonomic = bool(declaration.constraints)
        if method.scheme == "semi-explicit" and not holonomic or method.scheme == "collocated" and holonomic:
            continue  # two names of one scheme: each is used where it is the usual one
        try:
            model = build_model(declaration, named_scheme(declaration, method.scheme, method.order, method.gradient))
            row.cells[method], row.ledger[method] = _slope(model, stop, _shared(truth), scale)
        except DeclarationError as e:
            row.cells[method] = REASONS.get(e.rule, "no")
        except StepFailure as e:
            row.cells[method] = e.status.name.lower()
    return row


def _slope(model: Model, stop: float, truth: Array, scale: Array) -> tuple[str, float]:
    """The last slope above rounding, and the worst step residual of all runs."""
    errors, slopes, worst = [], [], 0.0
    for n in COUNTS:
        x, residual = trajectory(model, stop, n)
        errors.append(float(np.max(np.abs(_shared(x) - truth) / scale)))
        worst = max(worst, residual)
        if errors[-1] < FLOOR:
            break
        if len(errors) > 1:
            slopes.append(np.log2(errors[-2] / errors[-1]))
        if len(slopes) > 1 and abs(slopes[-1] - slopes[-2]) < SETTLED:
            break
    return (f"{slopes[-1]:.2f}" if slopes else "exact"), worst


def trajectory(model: Model, stop: float, n: int) -> tuple[Array, float]:
    """States after every step, and the worst step residual relative to the most energy in play so far.

    In play are sum |H| + |moved| + |dissipated| of the components and |port energies|; moved: of the terms of H, which counts
    where their sum is zero, as of a pendulum that falls from the height of its zero.
    """
    instance = PythonInstance(model)
    instance.set_input(_inputs(model))
    instance.initialise()
    names = ("x", "stored", "dissipated", "numerical", "supplied", "moved", "pairs", "energy")
    rows = instance.run(0.0, stop / n, n, names)
    left = np.abs(balance(rows["stored"], rows["dissipated"], rows["supplied"], rows["numerical"])).max(
        axis=1, initial=0.0
    )
    size = sum(np.abs(rows[name]).sum(axis=1) for name in ("moved", "dissipated", "pairs", "energy"))
    return rows["x"], float(np.max(left / np.maximum(np.maximum.accumulate(size), 1e-300), initial=0.0))


def _inputs(model: Model) -> Array:
    """Constant inputs that move a model at rest."""
    free = [p for p in model.declaration.ports if p.external]
    nominal = np.array([v for p in free for v in np.broadcast_to(p.nominal, p.n)])
    return model.u0 + 0.5 * nominal * (-1.0) ** np.arange(len(nominal))


def span(model: Model) -> float:
    """A time in which COUNTS[0] steps of order 6 are visibly coarse: twice as many change states by COARSE or more."""
    stop, ceiling = SHORTEST, LONGEST / 2
    while stop <= ceiling:
        try:
            (x, _), (y, _) = (trajectory(model, stop, n) for n in COUNTS[:2])
        except StepFailure:
            return stop / 2
        if np.max(np.abs(x - _shared(y)) / _scale(model, y)) > COARSE:
            return stop
        stop *= 2
    return 1.0  # every step is exact


def _shared(x: Array) -> Array:
    """Rows at the times of COUNTS[0] steps."""
    every = len(x) // COUNTS[0]
    return x[every - 1 :: every]


def _scale(model: Model, x: Array) -> Array:
    """Size of each state: the largest entry of its variable on the way, at least a trifle of the nominal value."""
    size, at = np.zeros(x.shape[1]), 0
    for v in model.declaration.states:
        part = slice(at, at + v.n)
        size[part] = np.maximum(np.max(np.abs(x[:, part])), 1e-6 * np.array(v.nominal))
        at += v.n
    return size


def table(rows: list[OrderRow]) -> str:
    """A Markdown table: a row per target, a column per method that fits somewhere, ledger closures at the margins."""
    fits = [m for m in methods() if any(m in r.ledger for r in rows)]
    exact = [m for m in fits if m.scheme != "midpoint"]
    head = ["target", *map(str, fits), "worst ledger"]
    lines = []
    for r in rows:
        worst = max((r.ledger[m] for m in exact if m in r.ledger), default=float("nan"))
        lines.append([r.target, *(r.cells.get(m, "") for m in fits), f"{worst:.0e}"])
    closing = [max(r.ledger[m] for r in rows if m in r.ledger) for m in fits]
    lines.append(["worst ledger", *(f"{c:.0e}" for c in closing), ""])
    return markdown_table(head, lines)
