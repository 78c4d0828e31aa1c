"""Observed orders and worst ledger closure of all schemes on everything in the library: `phfmu bench orders`.

Every target runs from its start with constant inputs over a few periods of its fastest mode.  Steps are halved until the
slope of the error settles; the reference is the scheme of order 6 with ORDER_6 steps.  A scheme that does not fit a target
gives the reason as a word.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from phfmu.declare.phdae import PHDAE
from phfmu.discretise.model import Model, build_model
from phfmu.discretise.scheme_names import GRADIENTS, ORDERS, SCHEMES
from phfmu.discretise.schemes import named_scheme
from phfmu.discretise.terms import DeclarationError
from phfmu.engine.python import PythonInstance
from phfmu.engine.status import StepFailure

Array = NDArray[np.float64]

COUNTS = (6, 12, 24, 48, 96)  # steps over SPAN/(fastest rate)
SPAN = 6.0
ORDER_6 = 128  # steps of the reference
FLOOR = 1e-11  # relative errors below are rounding
SETTLED = 0.03  # change of the slope from halving to halving
LARGEST = 60  # states; larger models repeat what smaller ones show
#: what a DeclarationError is about -> the word in the table
REASONS = (
    ("no holonomic", "no constraint"), ("constraints drift", "g drifts"),
    ("odd stages", "odd k"), ("drifts off", "odd k"), ("order 2", "order 2"),
    ("no discrete gradient", "order 2"), ("closed-form pair", "order 2"), ("diagonal", "diagonal E"),
    ("quadratic constraints", "quadratic g"), ("velocities as states", "velocities"), ("structurally", "singular"),
)  # fmt: skip


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
class Row:
    """Cells of one target: a slope or a word per method, and the worst ledger closure per method."""

    target: str
    cells: dict[Method, str] = field(default_factory=dict)
    ledger: dict[Method, float] = field(default_factory=dict)


def methods() -> list[Method]:
    """Every scheme with the default gradient in every order, every other gradient with the default scheme."""
    out = [Method(s, k) for s in SCHEMES if s != "auto" for k in ORDERS if k % 2 == (s == "radau")]
    return out + [Method("auto", k, g) for g in GRADIENTS if g != "per-term" for k in ORDERS if k % 2 == 0]


def targets(names: Sequence[str] = ()) -> Iterator[tuple[str, PHDAE]]:
    """Components and scenes of the library, or those named, that have 1 to LARGEST states."""
    from phfmu.components.library import LIBRARY, build

    for name in names or LIBRARY:
        found = build(name)
        declaration = found if isinstance(found, PHDAE) else found.declaration()
        if 1 <= sum(v.n for v in declaration.states) <= LARGEST:
            yield name, declaration


def measure(names: Sequence[str] = (), report: Callable[[str], None] = lambda text: None) -> list[Row]:
    """Rows of the targets; `report` is told what is being measured.  KeyError for a name the library does not have."""
    rows = []
    for name, declaration in targets(names):
        report(name)
        rows.append(_row(name, declaration))
    return rows


def _row(name: str, declaration: PHDAE) -> Row:
    row = Row(name)
    best = build_model(declaration, named_scheme(declaration, order=6))
    stop = SPAN / fastest(best)
    truth, _ = trajectory(best, stop, ORDER_6)
    scale = np.maximum(np.max(np.abs(truth), axis=0), 1e-300)
    for method in methods():
        holonomic = bool(declaration.constraints)
        if method.scheme == "semi-explicit" and not holonomic or method.scheme == "collocated" and holonomic:
            continue  # two names of one scheme: each is used where it is the usual one
        try:
            model = build_model(declaration, named_scheme(declaration, method.scheme, method.order, method.gradient))
            row.cells[method], row.ledger[method] = _slope(model, stop, truth[-1], scale)
        except DeclarationError as e:
            row.cells[method] = next((word for text, word in REASONS if text in str(e)), "no")
        except StepFailure as e:
            row.cells[method] = e.status.name.lower()
    return row


def _slope(model: Model, stop: float, truth: Array, scale: Array) -> tuple[str, float]:
    """The last slope above rounding, and the worst step residual of all runs."""
    errors, slopes, worst = [], [], 0.0
    for n in COUNTS:
        x, residual = trajectory(model, stop, n)
        errors.append(float(np.max(np.abs(x[-1] - truth) / scale)))
        worst = max(worst, residual)
        if errors[-1] < FLOOR:
            break
        if len(errors) > 1:
            slopes.append(np.log2(errors[-2] / errors[-1]))
        if len(slopes) > 1 and abs(slopes[-1] - slopes[-2]) < SETTLED:
            break
    return (f"{slopes[-1]:.2f}" if slopes else "exact"), worst


def trajectory(model: Model, stop: float, n: int) -> tuple[Array, float]:
    """States after every step, and the worst step residual relative to sum |H| + |supplied| + |dissipated|."""
    instance = PythonInstance(model)
    instance.set_input(_inputs(model))
    instance.initialise()
    rows = instance.run(0.0, stop / n, n, ("x", "stored", "dissipated", "numerical", "supplied", "energy"))
    left = np.abs(rows["stored"] + rows["dissipated"] + rows["numerical"] - rows["supplied"])
    size = np.sum(np.abs(rows["energy"]) + np.abs(rows["supplied"]) + np.abs(rows["dissipated"]), axis=1, keepdims=True)
    return rows["x"], float(np.max(left / np.maximum(size, 1e-300), initial=0.0))


def _inputs(model: Model) -> Array:
    """Constant inputs that move a model at rest."""
    free = [p for p in model.declaration.ports if p.external]
    nominal = np.array([v for p in free for v in np.broadcast_to(p.nominal, p.n)])
    return model.u0 + 0.5 * nominal * (-1.0) ** np.arange(len(nominal))


def fastest(model: Model) -> float:
    """Largest rate |lambda| of the linearised motion at the start.

    A short step multiplies a mode by mu = (1 + h lambda/2)/(1 - h lambda/2) + O(h^3), near 1; modes near -1 and 0 belong
    to constraints, which the perturbed states miss.
    """
    h = 1e-6
    for _ in range(6):
        mu = np.linalg.eigvals(_monodromy(model, h))
        mu = mu[mu.real > 0.5]
        rate = float(np.max(np.abs(2 * (mu - 1) / (h * (mu + 1))), initial=0.0))
        if rate * h > 1e-2:
            break
        h = min(0.05 / rate, 1.0) if rate > 0.05 else 1.0
    return max(rate, 1e-3)


def _monodromy(model: Model, h: float) -> Array:
    instance, u = PythonInstance(model), _inputs(model)
    nominal = np.array([v.nominal[j] for v in model.declaration.states for j in range(v.n)])
    size = 1e-5 * np.maximum(nominal, np.abs(model.x0))

    def after(x: Array) -> Array:
        instance.reset()
        instance.set_input(u)
        instance.set_x(0.0, x)
        instance.do_step(0.0, h)
        return instance.x

    base = after(model.x0)
    columns = [(after(model.x0 + size[j] * np.eye(len(size))[j]) - base) / size for j in range(len(size))]
    return np.column_stack(columns)


def table(rows: list[Row]) -> str:
    """A Markdown table: a row per target, a column per method that fits somewhere, ledger closures at the margins."""
    fits = [m for m in methods() if any(m in r.ledger for r in rows)]
    exact = [m for m in fits if m.scheme != "midpoint"]
    head = ["target", *map(str, fits), "worst ledger"]
    lines = [head, ["---"] * len(head)]
    for r in rows:
        worst = max((r.ledger[m] for m in exact if m in r.ledger), default=float("nan"))
        lines.append([r.target, *(r.cells.get(m, "") for m in fits), f"{worst:.0e}"])
    closing = [max(r.ledger[m] for r in rows if m in r.ledger) for m in fits]
    lines.append(["worst ledger", *(f"{c:.0e}" for c in closing), ""])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
