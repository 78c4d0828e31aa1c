"""The picture of docs/results/events.md: a breaker at a machine opens pole by pole, and what each jump moves and loses."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pages import DOCS, PageBlock

from phfmu import Collocated, NativeInstance, Options, build_model
from phfmu.audit import AuditWriter, read
from phfmu.components.library import builder
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.runs.loop import run
from phfmu.runs.result import Result
from phfmu.studies.figures import pyplot, save

STOP, STEP, OPENS, CHOP = 0.095, 1e-4, 80.0, 2000.0
PHASES = {1: ("a", "#1f6fb4"), 2: ("b", "#d1711b"), 3: ("c", "#5b8c3a")}
MEMBERS = {
    "gen": "machine",
    "line": "other line",
    "breaker": "line with breaker",
    "rest": "rest of line",
    "fault": "fault",
}
SHADES = ("#1f6fb4", "#8fb8d8", "#d1711b", "#e8b98f", "#8a8a8a")
LOST = "#b02a30"

Jumps = list[tuple[str, dict[str, float], float]]


def recorded(**how: Any) -> tuple[Result, Jumps]:
    """The scene `smib_breaker` and, per jump of its poles: guards, J by member, J lost."""
    scene = builder("smib_breaker")(**how)
    model = build_model(scene.declaration(), Collocated(2))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.audit.parquet"
        with AuditWriter(path) as writer:
            options = Options(stop=STOP, step=STEP, events=scene.events, sink=writer)
            result = run(Monolithic(model, NativeInstance(model)), options)
        rows = [r for r in read(path).to_pylist() if r["row"] == "event" and "breaker.pole" in (r["message"] or "")]
    jumps: Jumps = []
    for t in dict.fromkeys(r["t0"] for r in rows):
        own = [r for r in rows if r["t0"] == t]
        moved = {r["component"]: r["energy_jump"] for r in own}
        jumps.append((own[0]["message"], moved, sum(r["lost"] for r in own)))
    return result, jumps


def event_picture() -> PageBlock:
    """docs/results/img/events.png: currents of three poles that open one by one, energies of the jumps."""
    return PageBlock(draw=_draw)


def _draw() -> Sequence[Path]:
    plt = pyplot()

    plt.rcParams.update({"font.size": 9.5, "axes.spines.top": False, "axes.spines.right": False})
    figure, axes = plt.subplot_mosaic(
        [["currents", "currents"], ["jumps", "losses"]], figsize=(9.6, 6.8), layout="constrained", width_ratios=(1.45, 1)
    )  # fmt: skip
    (result, zeros), (_, chopped), (_, forced) = recorded(), recorded(chop=CHOP), recorded(forced=True)
    _currents(axes["currents"], result)
    _moved(axes["jumps"], chopped)
    _losses(axes["losses"], zeros, chopped, forced)
    path = DOCS / "results" / "img" / "events.png"
    save(figure, path)
    return (path,)


def _currents(ax: Any, result: Result) -> None:
    t = 1e3 * result.time
    ax.axhline(0, color="0.75", lw=0.8)
    ax.axvline(OPENS, color="0.4", lw=0.9, ls=":")
    ax.annotate("told to open", (OPENS, 0.97), (-4, 0), xycoords=("data", "axes fraction"), textcoords="offset points",
                color="0.3", va="top", ha="right")  # fmt: skip
    for j, (phase, colour) in PHASES.items():
        i, closed = result.column(f"breaker.i[{j}]") / 1e3, result.column(f"breaker.closed[{j}]")
        at = int(np.flatnonzero(np.diff(closed) < 0)[0])
        ax.plot(t[: at + 1], i[: at + 1], colour, lw=1.6, label=f"phase {phase}")
        ax.plot(t[at:], i[at:], colour, lw=1.1, alpha=0.5)
        ax.plot(t[at], 0.0, "o", color=colour, ms=7, mfc="white", mew=1.8, zorder=5)
        aside = (6, 9) if i[at - 5] > 0 else (6, -29)  # away from its own line
        ax.annotate(f"{phase} opens at\n{t[at]:.4f} ms", (t[at], 0.0), aside, textcoords="offset points", color=colour,
                    fontsize=9)  # fmt: skip
    ax.set(xlim=(70, 88), xlabel="time in ms", ylabel="current in kA",
           title="a fault is cut off from a 555 MVA machine: each pole opens where its current is zero")  # fmt: skip
    ax.legend(loc="upper right", ncols=3, frameon=False)


def _moved(ax: Any, jumps: Jumps) -> None:
    """Changes of the stored energies, and what is lost: they add up to zero."""
    width = 0.14
    for k, (_, moved, lost) in enumerate(jumps):
        values = [*(moved.get(m, 0.0) for m in MEMBERS), lost]
        for j, (value, colour) in enumerate(zip(values, (*SHADES, LOST), strict=True)):
            label = (*MEMBERS.values(), "lost")[j] if k == 0 else None
            ax.bar(k + (j - 2.5) * width, value / 1e3, 0.92 * width, color=colour, label=label)
    ax.axhline(0, color="0.3", lw=0.8)
    names = [f"pole {PHASES[int(said.split('pole')[1][0])][0]}" for said, _, _ in jumps]
    ax.set_xticks(range(len(jumps)), names)
    low, high = ax.get_ylim()
    ax.set(ylabel="energy in kJ", ylim=(low, high + 0.4 * (high - low)),
           title=f"poles that chop {CHOP / 1e3:g} kA: what each jump moves")  # fmt: skip
    ax.legend(frameon=False, fontsize=8.5, ncols=3, loc="upper left", columnspacing=1.0, handlelength=1.2)


def _joule(value: float) -> str:
    """A short number; powers of ten below a joule."""
    if value < 1:
        return f"$10^{{{int(np.floor(np.log10(value)))}}}$"
    return f"{value / 1e6:.1f} MJ" if value >= 1e6 else f"{value / 1e3:.1f} kJ"


def _losses(ax: Any, zeros: Jumps, chopped: Jumps, forced: Jumps) -> None:
    place, ticks = 0.0, list[tuple[float, str]]()
    for name, jumps in (("at its zero", zeros), (f"at {CHOP / 1e3:g} kA", chopped), ("forced,\nall three", forced)):
        first = place
        for said, _, lost in jumps:
            colour = PHASES[int(said.split("pole")[1][0])][1] if len(jumps) > 1 else "0.45"
            lost = abs(lost)
            ax.bar(place, lost, 0.8, bottom=0.0, color=colour)
            ax.annotate(_joule(lost), (place, lost), (0, 2), fontsize=8, textcoords="offset points", ha="center",
                        color="0.25")  # fmt: skip
            place += 1.25
        ticks.append(((first + place - 1.25) / 2, name))
        place += 1.0
    ax.set_yscale("log")
    ax.set_xticks([x for x, _ in ticks], [n for _, n in ticks])
    ax.set(ylabel="lost in J", ylim=(1e-30, 1e10), title="what opening a pole loses")
    ax.yaxis.get_major_locator().set_params(numticks=7)
