"""The pictures of README and docs, each from a run; nothing is drawn from stored numbers."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pages import DOCS, PageBlock

from phfmu import PHDAE, NativeInstance, Options, PythonInstance, build_model, default_scheme, energy, skew, state
from phfmu.audit import AuditWriter, read
from phfmu.components.library import build
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.runs.loop import run
from phfmu.runs.result import Result
from phfmu.studies.figures import pyplot, save

IMAGES = DOCS / "img"
COLOURS = {"gen": "#1f6fb4", "line": "#d1711b", "grid": "#5b8c3a"}


def recorded(name: str, order: int = 2) -> tuple[Result, Any]:
    """Result and audit table of the scene `name`."""
    scene = build(name)
    declaration = scene.declaration()
    model = build_model(declaration, default_scheme(declaration, order))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.audit.parquet"
        with AuditWriter(path) as writer:
            result = run(
                Monolithic(model, NativeInstance(model)),
                Options(stop=scene.stop, step=scene.step, events=scene.events, sink=writer),
            )
        return result, read(path)


def of_component(table: Any, name: str, column: str) -> np.ndarray:
    """One column of the component rows of `name`, a value per step."""
    rows = [np.asarray(table[c].to_pylist(), object) for c in ("row", "component")]
    chosen = (rows[0] == "component") & (rows[1] == name)
    return table[column].to_numpy()[chosen]


def through(table: Any, component: str, port: str) -> np.ndarray:
    """Energy through a scalar port, a value per step."""
    rows = [np.asarray(table[c].to_pylist(), object) for c in ("row", "component", "port")]
    chosen = (rows[0] == "port") & (rows[1] == component) & (rows[2] == port)
    return table["supplied"].to_numpy()[chosen]


def largest(values: np.ndarray, window: int) -> np.ndarray:
    """Largest magnitude in each window of steps."""
    return np.abs(values).reshape(-1, window).max(axis=1)


def smib_picture() -> PageBlock:
    """docs/img/smib.png: stator current and rotor speed after the torque step, and the ledger of every step."""
    return PageBlock(draw=_draw_smib)


def _draw_smib() -> Sequence[Path]:
    plt = pyplot()

    result, table = recorded("smib")
    t, window = result.time, 250
    plt.rcParams.update({"font.size": 9.5, "axes.spines.top": False, "axes.spines.right": False})
    figure, axes = plt.subplot_mosaic(
        [["current", "speed"], ["ledger", "ledger"]], figsize=(9, 5.6), layout="constrained"
    )

    shown = (t >= 0.4) & (t <= 1.4)
    axes["current"].plot(t[shown], result.column("gen.I[1]")[shown] / 1e3, COLOURS["gen"], lw=0.8)
    axes["current"].axvline(0.5, color="0.5", lw=0.9, ls=":")
    axes["current"].annotate("torque + 10 %", (0.5, 20.5), (4, 0), textcoords="offset points", color="0.3")
    axes["current"].set(
        xlabel="time in s",
        ylabel="current in kA",
        title="stator current, phase a",
        xlim=(0.4, 1.4),
        ylim=(-23, 23),
    )

    axes["speed"].plot(t, result.column("gen.shaft.speed"), COLOURS["gen"], lw=1.2)
    axes["speed"].axhline(2 * np.pi * 60, color="0.6", lw=0.8, ls=":")
    axes["speed"].annotate(
        "2π · 60 Hz", (0.02, 2 * np.pi * 60), (2, -12), textcoords="offset points", color="0.3", fontsize=8
    )
    axes["speed"].set(xlabel="time in s", ylabel="speed in rad/s", title="rotor speed", xlim=(0, 5))

    middle = (t[1:].reshape(-1, window)[:, 0] + t[1:].reshape(-1, window)[:, -1]) / 2
    ax = axes["ledger"]
    ax.semilogy(middle, largest(through(table, "gen", "shaft"), window), "0.35", lw=1.4)
    ax.annotate("supplied by the shaft", (0.1, 1.2e5), color="0.25")
    for name in ("gen", "line"):
        ax.semilogy(middle, largest(of_component(table, name, "dissipated"), window), COLOURS[name], lw=1.4, ls="--")
        ax.semilogy(
            middle,
            np.maximum(largest(of_component(table, name, "residual"), window), 1e-18),
            COLOURS[name],
            lw=1.4,
        )
    ax.annotate("dissipated: machine and line (dashed)", (0.1, 2.5e1), color="0.25")
    ax.annotate("residual of the machine's balance", (0.1, 5e-10), color=COLOURS["gen"])
    ax.annotate("residual of the line's balance", (0.1, 2e-13), color=COLOURS["line"])
    ax.set(
        xlabel="time in s",
        ylabel="energy per step in J",
        xlim=(0, 5),
        ylim=(3e-14, 3e6),
        title=f"energy ledger, largest value in {window} steps of 0.1 ms: stored + dissipated − supplied = rounding",
    )
    ax.grid(axis="y", color="0.9")

    path = IMAGES / "smib.png"
    save(figure, path)
    return (path,)


def skew_picture() -> PageBlock:
    """docs/img/skew.png: which way `skew(a, b, 1)` turns the point (a, b), and `skew(b, a, 1)`."""
    return PageBlock(draw=_draw_skew)


def turned(swapped: bool) -> np.ndarray:
    """Rows (a, b) of H = (a^2 + b^2)/2 from (0.6, 0.8) for 5 s."""
    a, b = state("a", start=0.6), state("b", start=0.8)
    block = skew(b, a, 1.0) if swapped else skew(a, b, 1.0)
    model = build_model(PHDAE("turn", states=(a, b), energies=(energy((a**2 + b**2) / 2),), structure=(block,)))
    rows = PythonInstance(model).run(0.0, 0.01, 500, ("x",))["x"]
    return np.vstack([[0.6, 0.8], rows])


def _draw_skew() -> Sequence[Path]:
    plt = pyplot()

    plt.rcParams.update({"font.size": 10})
    figure, axes = plt.subplots(1, 2, figsize=(8, 4), layout="constrained")
    cases = (
        ("skew(a, b, 1):  a' = z_b,  b' = −z_a", False, "gen"),
        ("skew(b, a, 1):  a' = −z_b,  b' = z_a", True, "line"),
    )
    for ax, (title, swapped, name) in zip(axes, cases, strict=True):
        x = turned(swapped)
        ax.plot(*x.T, COLOURS[name], lw=1.8)
        ax.plot(*x[0], "o", color=COLOURS[name])
        ax.annotate("start", x[0], (6, 6), textcoords="offset points", color="0.3")
        for k in (150, 300, 499):
            ax.annotate(
                "", x[k + 1], x[k - 9], arrowprops={"arrowstyle": "-|>", "color": COLOURS[name], "mutation_scale": 22}
            )
        ax.axhline(0.0, color="0.8", lw=0.8, zorder=0)
        ax.axvline(0.0, color="0.8", lw=0.8, zorder=0)
        ax.set(title=title, xlabel="a", ylabel="b", xlim=(-1.3, 1.3), ylim=(-1.3, 1.3), aspect="equal")
    path = IMAGES / "skew.png"
    save(figure, path, 120)
    return (path,)
