"""Outcomes of a step: one enumeration whose values are the messages, and the exception that carries them."""

from __future__ import annotations

from enum import Enum


class Status(Enum):
    """Outcome of a solve; the order is that of `ph_status` in `runtime/phfmu.h`."""

    OK = "step accepted"
    NO_CONVERGENCE = "Newton's method did not converge, not even on the smallest substep"
    SINGULAR = "the Newton matrix is singular: an equation is missing or redundant"
    NOT_FINITE = "a value is not finite"
    LU_CAPACITY = "the factors of the Newton matrix outgrew the reserved memory"
    ABI = "model tables and compiled runtime do not belong together"
    ARGUMENT = "an argument is out of range"
    NO_SENSITIVITY = "the sensitivity needs a last step that is one undivided step"


REMEDY = {
    Status.NO_CONVERGENCE: "reduce the step, or check the inputs and start values near this time",
    Status.SINGULAR: "check that every unknown is determined by an equation (`phfmu check`)",
    Status.NOT_FINITE: "check inputs and parameters, or reduce the step: the state may have left the domain of H",
    Status.LU_CAPACITY: "build the model again at a typical state",
    Status.ABI: "empty the cache folder (PHFMU_CACHE_DIR) and build again",
    Status.ARGUMENT: "h must be positive and finite, node inputs need a Gauss scheme",
    Status.NO_SENSITIVITY: "use one internal step per communication step, or finite differences",
}


class StepFailure(RuntimeError):
    """A step that was refused; the instance is at its last accepted step.

    `time`, `h`: start and length (s) of the refused (sub)step; `equation`: row of the largest scaled residual
    or None, `name` its name; `residual`: that scaled residual; `update`: last scaled update norm (1 = nominal);
    `unknown`: unknown without a pivot in a singular matrix, or None; `instant`: the end values failed, not the step.
    """

    def __init__(
        self,
        status: Status,
        *,
        time: float = float("nan"),
        h: float = float("nan"),
        equation: int | None = None,
        name: str | None = None,
        unknown: int | None = None,
        residual: float = float("nan"),
        update: float = float("nan"),
        iterations: int = 0,
        instant: bool = False,
    ) -> None:
        self.status = status
        self.time = time
        self.h = h
        self.equation = equation
        self.name = name
        self.unknown = unknown
        self.residual = residual
        self.update = update
        self.iterations = iterations
        self.instant = instant
        super().__init__(self._text())

    def _text(self) -> str:
        where = f"end values at t = {self.time:.9g}" if self.instant else f"t = {self.time:.9g}, h = {self.h:.3g}"
        text = f"{where}: {self.status.value}"
        if self.equation is not None:
            text += f"; worst equation {self.equation}" + (f" ({self.name})" if self.name else "")
            text += f", scaled residual {self.residual:.3g}, last update {self.update:.3g}"
            text += f" after {self.iterations} iterations"
        if self.unknown is not None:
            text += f"; unknown {self.unknown}" + (f" ({self.name})" if self.name else "") + " has no pivot"
        return text + (f". Next: {REMEDY[self.status]}." if self.status in REMEDY else "")
