"""Reactances and time constants of a synchronous machine from a sudden short circuit with noise, and what such a fit costs.

The measurements are of Kundur's equations in the rotor's frame and per unit, integrated by DOP853; the fit steps the machine in
currents of the phases, whose start is what is measured before the short circuit: currents, field voltage, speed and angle.

Source: IEEE Std 115; Kundur, Power System Stability and Control, 1994, chapters 3 and 4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.studies.bench.machine import cpu_seconds, machine_line
from phfmu.studies.figures import pyplot, save
from phfmu.studies.tables import markdown_table

if TYPE_CHECKING:
    from phfmu.components.electrical import MachineData
    from phfmu.components.electrical.machines.machine_init import OperatingPoint
    from phfmu.declare.phdae import PHDAE
    from phfmu.derivatives.fits.fit import Fit
    from phfmu.results.table import Table

Array = NDArray[np.float64]

MACHINE = "kundur555_1q"
#: what is sought, and where a fit begins, in parts of the true values
FREE = {"xd": 1.2, "xd1": 0.85, "xd2": 0.9, "xq": 1.2, "xq2": 1.15, "Td10": 0.8, "Td20": 1.25, "Tq20": 0.8}
MEASURED = ("I[1]", "I[2]", "I[3]", "I[4]")
#: of the largest size of each current; s between measurements, of the run, of a step
NOISE, EVERY, STOP, STEP = 0.02, 1e-3, 1.0, 1e-4
#: power before the short circuit, in parts of 0.8 and 0.2 of the rated active and reactive one
LOADED, UNLOADED = 1.0, 0.0
DRAWS = 60
SHORT = {f"terminal.v[{i}]": 0.0 for i in (1, 2, 3)}
ALPHA = np.array([0.0, 2.0, -2.0]) * np.pi / 3.0


def before(part: float) -> tuple[MachineData, OperatingPoint]:
    """The machine, and its steady state before the short circuit."""
    from phfmu.components.electrical import machine_set, steady_state

    data = machine_set(MACHINE)
    return data, steady_state(data, P=0.8 * part * data.Sn, Q=0.2 * part * data.Sn)


def machine(part: float) -> PHDAE:
    from phfmu.components.electrical import synchronous_machine

    data, start = before(part)
    return synchronous_machine(data, coordinates="current", parameters="operational", start=start)


@cache
def true() -> dict[str, float]:
    values = {v.name: float(v.start[0]) for v in machine(LOADED).parameters}
    return {name: values[name] for name in FREE}


@cache
def integrated(part: float) -> tuple[Array, Array]:
    """Times [s] and currents of phases and field [A] after the short circuit, without noise."""
    from scipy.integrate import solve_ivp

    from phfmu.components.electrical import reactances

    data, start = before(part)
    x, w = reactances(data), data.omega
    xl, ra = (data.Ll or 0.0) * w / (data.Vn_rms_ll**2 / data.Sn), x["ra"]
    md, mq, tail = x["xd"] - xl, x["xq"] - xl, x["xd1"] - xl
    xf, xk = md * tail / (md - tail), tail * (x["xd2"] - xl) / (x["xd1"] - x["xd2"])
    xkq = mq * (x["xq2"] - xl) / (x["xq"] - x["xq2"])
    rotor_d = np.array([ra, (md + xf) / (w * x["Td10"]), (xk + tail) / (w * x["Td20"])])
    rotor_q = np.array([ra, (mq + xkq) / (w * x["Tq20"])])
    Ld, Lq = md + np.diag([xl, xf, xk]), mq + np.diag([xl, xkq])
    Gd, Gq = np.linalg.inv(Ld), np.linalg.inv(Lq)
    base, field = (
        np.sqrt(2 / 3) * data.Sn / data.Vn_rms_ll,
        np.sqrt(2 / 3) * data.Vn_rms_ll / w / data.M_stator_rotor[0],
    )
    turned = np.exp(-1j * (start.theta - ALPHA))
    i = 2 / 3 * np.sum(np.array(start.I[:3]) / turned.conj()) / base if part else 0.0 + 0.0j
    i_f = start.I[3] / (field * md)
    fluxes = np.concatenate([Ld @ [i.real, i_f, 0.0], Lq @ [i.imag, 0.0]])
    inertia, torque = data.J * w**2 / data.Sn, start.tau * w / data.Sn
    v_f = np.array([0.0, rotor_d[1] * i_f, 0.0])

    def rate(t: float, y: Array) -> Array:
        d, q, speed = y[:3], y[3:5], y[5]
        i_d, i_q = Gd @ d, Gq @ q
        down, across = v_f - rotor_d * i_d, -rotor_q * i_q
        down[0] += speed * q[0]
        across[0] -= speed * d[0]
        turn = (torque + d[0] * i_q[0] - q[0] * i_d[0]) / inertia
        return np.concatenate([w * down, w * across, [turn, w * speed]])

    times = np.asarray(EVERY * np.arange(round(STOP / EVERY) + 1), np.float64)
    y0 = np.concatenate([fluxes, [1.0, start.theta]])
    y: Array = solve_ivp(rate, (0.0, STOP), y0, method="DOP853", rtol=1e-10, atol=1e-12, t_eval=times).y
    i_d, i_q, a = Gd @ y[:3], Gq @ y[3:5], y[6][:, None] - ALPHA
    phases: Array = base * (np.cos(a) * i_d[0][:, None] - np.sin(a) * i_q[0][:, None])
    return times, np.column_stack([phases, field * md * i_d[1]])


def measured(part: float, seed: int) -> Table:
    """The currents with noise."""
    from phfmu.results.table import Table

    times, rows = integrated(part)
    noise = NOISE * np.abs(rows).max(axis=0) * np.random.default_rng(seed).normal(size=rows.shape)
    return Table(list(MEASURED), times, rows + noise, ["A"] * len(MEASURED))


@dataclass(frozen=True)
class TimedFit:
    """A fit by exact derivatives and its CPU time [s]."""

    found: Fit
    spent: float

    @property
    def off(self) -> dict[str, float]:
        """Deviations from the true values in standard errors."""
        return {n: (self.found.values[n] - x) / self.found.errors[n] for n, x in true().items()}

    @property
    def joint(self) -> float:
        """All deviations at once: off^T C^-1 off / n with the correlations C of the estimates, 1 on average."""
        off = np.array(list(self.off.values()))
        return float(off @ np.linalg.solve(self.found.correlation, off) / len(off))


class ShortCircuitFits:
    """Fits of short circuits at a load, all by one compiled model."""

    def __init__(self, part: float = LOADED):
        from phfmu.discretise.model import build_model
        from phfmu.engine.native.native import NativeInstance
        from phfmu.runs.options import Options

        begin = {n: FREE[n] * x for n, x in true().items()}
        self.part, self.model = part, build_model(machine(part).with_starts(begin))
        self.instance, self.options = NativeInstance(self.model), Options(stop=STOP, step=STEP)

    def exact(self, seed: int) -> TimedFit:
        """A fit by the derivatives of the steps."""
        from phfmu.derivatives.fits.fit import Experiment, fit

        found: list[Fit] = []
        own = [Experiment("short circuit", measured(self.part, seed), self.options, SHORT)]
        spent = cpu_seconds(lambda: found.append(fit(self.model, self.instance, own, list(FREE), MEASURED)))
        return TimedFit(found[0], spent)

    def differences(self, seed: int, points: str) -> tuple[Array, int, int, float]:
        """A fit by differences of plain runs (`2-point`, `3-point`): values, iterations, runs, CPU time [s]."""
        from dataclasses import replace

        from scipy.optimize import least_squares

        from phfmu.derivatives.derived import DerivedSteps
        from phfmu.derivatives.interpolation import LinearInterpolation
        from phfmu.outcome.status import StepFailure
        from phfmu.runs.loop import run

        data = measured(self.part, seed)
        stepper, size = DerivedSteps(self.model, self.instance, list(FREE)), np.abs(data.values).max(axis=0)
        options, runs = replace(self.options, signals=list(MEASURED), audited=False), [0]
        start = np.array([FREE[n] * x for n, x in true().items()])

        def residual(theta: Array) -> Array:
            runs[0] += 1
            try:
                stepper.begin(SHORT | dict(zip(FREE, theta.tolist(), strict=True)))
                result = run(stepper, options)
            except (StepFailure, FloatingPointError):
                return np.full(data.values.size, np.nan)
            at = LinearInterpolation(result.time, data.time, "measurements")
            rows = np.column_stack([at.of(result.column(m)) for m in MEASURED])
            return ((rows - data.values) / size).ravel()

        found: list[Any] = []
        spent = cpu_seconds(lambda: found.append(least_squares(
            residual, start, points, (0.0, np.inf), "trf", x_scale=start, ftol=1e-12, xtol=1e-12, gtol=1e-14, max_nfev=200,
        )))  # fmt: skip
        return found[0].x, int(found[0].nfev), runs[0], spent


@dataclass(frozen=True)
class FitStudy:
    """Fits of draws of the noise, those by differences of the first ones, and the first fit of a machine without load."""

    fits: tuple[TimedFit, ...]
    differences: dict[str, tuple[tuple[Array, int, int, float], ...]]
    unloaded: TimedFit


#: of how many draws the fits by differences are taken, in turn with those by exact derivatives
COMPARED = {"2-point": 5, "3-point": 5}


def study(draws: int = DRAWS, progress: Callable[[str], None] = lambda _: None) -> FitStudy:
    fits, others = ShortCircuitFits(), dict[str, list[tuple[Array, int, int, float]]]()
    for part in (LOADED, UNLOADED):
        integrated(part)
    fits.exact(0)  # compiles
    found = []
    for seed in range(draws):
        progress(f"draw {seed + 1} of {draws}")
        found.append(fits.exact(seed))
        for points, most in COMPARED.items():
            if seed < most:
                others.setdefault(points, []).append(fits.differences(seed, points))
    progress("without load")
    return FitStudy(tuple(found), {k: tuple(v) for k, v in others.items()}, ShortCircuitFits(UNLOADED).exact(0))


def pairs(found: Fit, least: float = 0.95) -> list[tuple[str, str, float]]:
    """Pairs of values that go together: names, correlation."""
    n = len(found.free)
    every = [(found.free[j], found.free[i], float(found.correlation[i, j])) for i in range(n) for j in range(i)]
    return [p for p in every if abs(p[2]) > least]


def within(found: Fit, most: float = 3.0) -> float:
    """The part of draws in which normal deviations with the correlations of a fit are all within so many standard errors."""
    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(len(found.free)), found.correlation, 200_000)
    return float(np.mean(np.abs(drawn).max(axis=1) <= most))


def values_table(s: FitStudy) -> str:
    head = ["name", "true", "first draw", "its standard error", "largest deviation, errors", "draws within 3 errors",
            "without load: standard error"]  # fmt: skip
    rows = []
    for name, x in true().items():
        off = np.abs([f.off[name] for f in s.fits])
        first, errors = s.fits[0].found, s.unloaded.found.errors
        rows.append([
            name, f"{x:.4g}", f"{first.values[name]:.4g}", f"{100 * first.errors[name] / x:.2g} %", f"{off.max():.2f}",
            f"{int((off <= 3).sum())} of {len(off)}", f"{100 * errors[name] / x:.2g} %",
        ])  # fmt: skip
    return markdown_table(head, rows)


def cost_table(s: FitStudy) -> str:
    """A table of iterations, runs and CPU times, medians over draws that all fits are made of in turns."""
    first = max(COMPARED.values())
    exact = [f.spent for f in s.fits[:first]]
    head = ["derivatives", "iterations", "runs", "CPU, s", "to exact ones", "largest difference to exact, errors"]
    few = [f.found for f in s.fits[:first]]
    rows = [["exact", f"{median(f.iterations for f in few):g}", f"{median(f.runs for f in few):g}",
             f"{median(exact):.2f}", "1", "-"]]  # fmt: skip
    for points, others in s.differences.items():
        ratio = median(o[3] / e for o, e in zip(others, exact, strict=False))
        apart = max(
            float(np.max(np.abs(o[0] - list(f.values.values())) / list(f.errors.values())))
            for o, f in zip(others, few, strict=False)
        )
        rows.append([points, f"{median(o[1] for o in others):g}", f"{median(o[2] for o in others):g}",
                     f"{median(o[3] for o in others):.2f}", f"{ratio:.1f}", f"{apart:.0e}"])  # fmt: skip
    return markdown_table(head, rows)


def told(s: FitStudy) -> str:
    """The pair of values that a short circuit without load does not tell apart."""
    return "; ".join(f"`{a}` and `{b}`, correlation {c:.4f}" for a, b, c in pairs(s.unloaded.found))


def table(progress: Callable[[str], None] = lambda _: None) -> str:
    """Both tables in Markdown, the pair that a machine without load leaves open, and the machine."""
    s = study(progress=progress)
    return f"{values_table(s)}\n\n{cost_table(s)}\n\nwithout load go together: {told(s)}\n\n{machine_line()}"


PAGE = """# Fits

A turbine generator of 555 MVA is short-circuited at its terminals, all phases at once, out of 0.8 of its rated power. From the
currents of the phases and of the field over one second, a value each millisecond with noise of 2 % of the largest one,
`phfmu fit` finds eight reactances and time constants, which are
[parameters of the machine](../use/machine-parameters.md#reactances-as-parameters); fits begin 10 to 25 % off. The measurements
are not of our own steps but of Kundur's equations in the rotor's frame, integrated by DOP853 with `rtol = 1e-10`; the runs have
steps of 0.1 ms at order 2.

    phfmu bench fit -o docs/results/fits.md

"""


def page(progress: Callable[[str], None] = lambda _: None, picture: Path | None = None) -> str:
    """The page of the results; `picture`: where its picture is drawn."""
    s = study(progress=progress)
    if picture is not None:
        draw(s, picture)
    off = np.array([list(f.off.values()) for f in s.fits])
    good, beyond, size = int(np.sum(np.abs(off).max(axis=1) <= 3)), int(np.sum(np.abs(off) > 3)), off.size
    return f"""{PAGE}{values_table(s)}

In {good} of {len(s.fits)} draws all eight values are within three of their standard errors of the true ones; of {size} deviations
{beyond} {"is" if beyond == 1 else "are"} larger, where normal ones have {0.0027 * size:.1f}; normal deviations with the
correlations of the first fit are all within three in {100 * within(s.fits[0].found):.0f} % of draws. Their root mean square is
{np.sqrt(np.mean(off**2)):.2f} standard errors; the mean square of the eight at once, in the metric of their covariance, is
{np.mean([f.joint for f in s.fits]):.2f} (1 expected, its own deviation {np.sqrt(2 / size):.2f}). The error of the steps is seen
there first: those of 0.2 ms move each value by a tenth of its standard error only, but all in the one direction that the data
tell best, and the mean square is 1.23.

![Currents of the phases and the field, measured and fitted, and deviations of all draws](img/fits.png)

## What a short circuit without load does not tell

Out of no load the flux lies on the d axis, and the q axis sees nothing but the offset of the phase currents, which turns at rated
frequency in its frame. There its reactance is all but `xq2 + xq/(j omega Tq20)`. The fit tells which values go together:
{told(s)}. The last column above has their standard errors; all others are found as well as
under load.

## Cost

The same least squares (SciPy's trust region, same tolerances) with the derivatives of the steps, and by differences of plain runs
of the same engine. CPU time by one thread, fits in turn on the same draws, medians of {max(COMPARED.values())}.

{cost_table(s)}

{machine_line()}
"""


def draw(s: FitStudy, path: Path) -> None:
    """Currents of phase a and the field, measured and fitted, and deviations of all draws."""
    plt = pyplot()

    plt.rcParams.update({"font.size": 9.5, "axes.spines.top": False, "axes.spines.right": False})
    figure, axes = plt.subplot_mosaic(
        [["phase", "off"], ["field", "off"]], figsize=(9.6, 5.2), layout="constrained", width_ratios=(1.6, 1)
    )
    curves = {m: (t, data, model) for _, m, t, data, model in s.fits[0].found.curves}
    for where, name, label in (("phase", "I[1]", "phase a"), ("field", "I[4]", "field")):
        t, data, model = curves[name]
        ax = axes[where]
        ax.plot(1e3 * t, data / 1e3, ".", color="0.6", ms=2.2, label="measured")
        ax.plot(1e3 * t, model / 1e3, color="#1f6fb4", lw=0.9, label="fit")
        ax.set(ylabel=f"{label}, kA", xlim=(0, 400))
        ax.legend(loc="upper right", ncols=2, frameon=False)
    axes["phase"].set_title("a short circuit out of 0.8 of rated power")
    axes["field"].set_xlabel("time in ms")
    _deviations(axes["off"], s.fits)
    save(figure, path)


def _deviations(ax: Any, fits: Sequence[TimedFit]) -> None:
    ax.axvspan(-3, 3, color="#1f6fb4", alpha=0.08, lw=0)
    ax.axvspan(-1, 1, color="#1f6fb4", alpha=0.12, lw=0)
    for place, name in enumerate(FREE):
        spread = place + np.linspace(-0.28, 0.28, len(fits))
        ax.plot([f.off[name] for f in fits], spread, "o", ms=3.2, color="#d1711b", mec="none")
    ax.set_yticks(range(len(FREE)), list(FREE))
    ax.invert_yaxis()
    ax.set(xlim=(-4, 4), xlabel="(found - true) / standard error", title=f"{len(fits)} draws of the noise")
