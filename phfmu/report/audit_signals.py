"""The signals of an audit: powers, stored energies, residuals, iterations, step sizes."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from phfmu.report.page.history import Columns, History
from phfmu.report.picture.prefix import engineering
from phfmu.report.recording import Floats, Mark, Signal, together

POWER, LOSS, STORED = (
    "power into the component, mean over the step",
    "dissipated power",
    "stored energy since the start",
)
RESIDUAL, ITERATIONS, STEP = (
    "|residual| of the balance of a step (dashed: allowed)",
    "Newton iterations of a step",
    "step size",
)
#: what to say where the signals of a model are looked for
HOLDS = (
    "an audit holds '*.power', '*.H', '*.residual', 'iterations' ..; the model's signals are in the table that "
    "phfmu run TARGET -o RUN.csv writes"
)
#: of the ratio that a log records
RECORDED_RTOL = 1e-11


class AuditSignals:
    """A recording made of an audit; what it has nothing for is not among its names.

    NAME.PORT.power, NAME.dissipated_power [W]; NAME.H [J] less its first value; NAME.residual of components and
    junctions, NAME.allowed [J]; iterations; step_size [s].
    """

    def __init__(self, history: History):
        self.history = history

    @property
    def title(self) -> str:
        about = self.history.about
        return ": ".join(str(about[k]) for k in ("target", "run") if about.get(k)) or Path(self.history.path).name

    @property
    def names(self) -> list[str]:
        return list(self._makers)

    @property
    def kinds(self) -> dict[str, str]:
        return {}

    @property
    def labelled(self) -> dict[str, str]:
        return {}

    def usual(self) -> list[str]:
        return self.names

    def read(self, names: Sequence[str]) -> list[Signal]:
        """Signals by their exact names; a component has its colour on all axes."""
        owners = {name: i for i, (name,) in enumerate((*self.history.components, *self.history.junctions))}
        return [replace(make(), owner=owners.get(owner)) for owner, make in (self._makers[n] for n in names)]

    def marks(self) -> list[Mark]:
        return marks(self.history)

    @cached_property
    def _makers(self) -> dict[str, tuple[str, Callable[[], Signal]]]:
        """The owner of each signal, and the function that makes it."""
        h, made = self.history, dict[str, tuple[str, Callable[[], Signal]]]()
        for (component, port, _), c in h.ports.items():
            name = f"{component}.{port}.power"
            made[name] = component, lambda name=name, c=c: Signal(name, "W", *_power(c, "supplied"), topic=POWER)
        for (component,), c in h.components.items():
            if _any(c["dissipated"]):
                name = f"{component}.dissipated_power"
                made[name] = component, lambda name=name, c=c: Signal(name, "W", *_power(c, "dissipated"), topic=LOSS)
        for (component,), c in h.components.items():
            if _any(c["H0"]) or _any(c["H1"]):
                made[f"{component}.H"] = component, lambda name=f"{component}.H", c=c: _stored(name, c)
        for (name,), c in (*h.components.items(), *h.junctions.items()):
            if _any(c["residual"]):
                made[f"{name}.residual"] = name, lambda name=name, c=c: _residual(name, c)
            if _any(c.get("residual_rel", np.zeros(0))):
                made[f"{name}.allowed"] = name, lambda name=name, c=c: _allowed(name, c)
        made |= self._solver()
        return made

    def _solver(self) -> dict[str, tuple[str, Callable[[], Signal]]]:
        """Iterations where the log has them, and step sizes where they differ."""
        steps, made = self.history.steps, dict[str, tuple[str, Callable[[], Signal]]]()
        spent, sizes = steps["iterations"], steps["h"]
        if _any(spent):
            made["iterations"] = "", lambda: Signal("iterations", "1", _middle(steps), spent, topic=ITERATIONS)
        if len(sizes) and np.ptp(sizes) > 1e-9 * sizes.max():
            made["step_size"] = "", lambda: Signal("step_size", "s", _middle(steps), sizes, topic=STEP)
        return made


def marks(history: History) -> list[Mark]:
    """The events, those of one time together."""
    return together(
        Mark(t, _NUMBER.sub(_short, message) or kind)
        for (kind, _, message), c in history.events.items()
        for t in c["t0"].tolist()
    )


#: the value of an event, as the log writes it
_NUMBER = re.compile(r"(?<== )-?\d[\d.]*(?:e[+-]?\d+)?$")


def _short(number: re.Match[str]) -> str:
    return f"{float(number[0]):.5g}"


def per_step(c: Columns, name: str) -> tuple[Columns, Floats]:
    """Columns of one row a step, and the sum of a column over the pairs of a vector port."""
    first = np.flatnonzero(np.diff(c["step"], prepend=np.nan) != 0)
    return {n: c[n][first] for n in ("t0", "h")}, np.add.reduceat(c[name], first)


def _power(c: Columns, name: str) -> tuple[Floats, Floats]:
    when, energy = per_step(c, name)
    with np.errstate(divide="ignore", invalid="ignore"):
        return _middle(when), energy / when["h"]


def _middle(c: Columns) -> Floats:
    return c["t0"] + 0.5 * c["h"]


def _stored(name: str, c: Columns) -> Signal:
    start = float(c["H0"][0])
    time, values = np.append(c["t0"][0], c["t0"] + c["h"]), np.append(start, c["H1"])
    return Signal(f"{name} − {engineering(start, 'J')}" if start else name, "J", time, values - start, topic=STORED)


def _residual(name: str, c: Columns) -> Signal:
    return Signal(f"{name}.residual", "J", _middle(c), c["residual"], topic=RESIDUAL, log=True)


def _allowed(name: str, c: Columns) -> Signal:
    """The residual that the verdict allows at its usual tolerance: the log records how large the residual is against it."""
    there = (c["residual"] != 0.0) & (c["residual_rel"] > 0.0)
    allowed = RECORDED_RTOL * np.abs(c["residual"][there]) / c["residual_rel"][there]
    return Signal(f"{name}.allowed", "J", _middle(c)[there], allowed, topic=RESIDUAL, log=True, limit=True)


def _any(values: Floats) -> bool:
    return bool((np.nan_to_num(values) != 0.0).any())
