"""Tables and picture of docs/understand/mental-model.md, from the declarations that stand on the page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pages import DOCS, PageBlock, declared, table

from phfmu import Coupled, EngineMember, NativeInstance, Network, Options, PythonInstance, build_model, run
from phfmu.runs.result import Result
from phfmu.studies.figures import pyplot, save

STEP, VOLTAGE = 2e-3, 24.0
COIL, PLATES, LOST, BANK, LEAK = "#1f6fb4", "#5b8c3a", "#b9402f", "#d1711b", "#8a6bb1"


def circuit() -> Any:
    return declared("understand/mental-model.md", "rlc")()


def energies(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Energy of coil and capacitor in joule at the states x = (flux, charge), written out."""
    p = {v.name: float(v.start[0]) for v in circuit().parameters}
    return x[0] ** 2 / (2 * p["L"]) + x[0] ** 4 / (4 * p["K"]), x[1] ** 2 / (2 * p["C"])


def step(h: float) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
    """States before and after a step of h seconds at 24 V, and its ledger."""
    unit = PythonInstance(build_model(circuit()))
    before = unit.x.copy()
    unit.set_input([VOLTAGE])
    unit.do_step(0.0, h)
    return before, unit.x.copy(), {name: float(np.sum(value)) for name, value in unit.ledger().items()}


def one_step() -> PageBlock:
    """A step of 2 ms at 24 V: both states at its ends, the slopes of H at its start, and those between its ends."""
    before, after, _ = step(STEP)
    parts = zip(energies(before), energies(after), strict=True)
    chords = [float((b - a) / d) for (a, b), d in zip(parts, after - before, strict=True)]
    tangents = [
        float((energies(before + d)[i] - energies(before - d)[i]) / 2e-7) for i, d in enumerate(1e-7 * np.eye(2))
    ]
    rows = [
        [label, f"{x:.6g}", f"{y:.6g}", f"{t:.6g} {unit}", f"{c:.6g} {unit}"]
        for label, x, y, t, c, unit in zip(
            ("flux in Wb", "charge in C"), before, after, tangents, chords, ("A", "V"), strict=True
        )
    ]
    return table(["", "at the start", "at the end", "slope of H at the start", "slope of the step"], rows)


def one_balance() -> PageBlock:
    """The energies of that step in millijoule; the residual in joule."""
    before, after, book = step(STEP)
    coil, plates = (float(b - a) for a, b in zip(energies(before), energies(after), strict=True))
    residual = abs(book["stored"] + book["dissipated"] - book["supplied"])
    cells = [f"{1e3 * e:.4f}" for e in (coil, plates, book["dissipated"], book["supplied"])]
    head = ["stored in the coil", "stored in the capacitor", "dissipated", "supplied", "residual in J"]
    return table(head, [[*cells, f"{residual:.0g}"]])


def mental_model_picture() -> PageBlock:
    """docs/img/mental-model.png: circuit, slope of a step, energy of a step, ledger of a run."""
    return PageBlock(draw=_draw)


def _draw() -> Sequence[Path]:
    plt = pyplot()

    plt.rcParams.update({"font.size": 9.5, "axes.spines.top": False, "axes.spines.right": False})
    figure, axes = plt.subplots(2, 2, figsize=(9, 6.4), layout="constrained", width_ratios=(1, 1.15))
    _circuit(axes[0, 0])
    _slope(axes[0, 1])
    _energy(axes[1, 0])
    _ledger(axes[1, 1])
    path = DOCS / "img" / "mental-model.png"
    save(figure, path)
    return (path,)


def _circuit(ax: Any) -> None:
    """The circuit with its port."""
    wire = {"color": "0.2", "lw": 1.6}
    ax.plot([0.6, 2.0], [4, 4], **wire)
    turn = np.linspace(np.pi, 0, 40)
    for i in range(4):
        ax.plot(2.2 + 0.4 * i + 0.2 * np.cos(turn), 4 + 0.42 * np.sin(turn), color=COIL, lw=2)
    ax.plot([3.6, 4.4], [4, 4], **wire)
    ax.plot([4.4, 5.8, 5.8, 4.4, 4.4], [3.75, 3.75, 4.25, 4.25, 3.75], color=LOST, lw=2)
    ax.plot([5.8, 6.8, 6.8], [4, 4, 2.6], **wire)
    for y in (2.6, 2.3):
        ax.plot([6.3, 7.3], [y, y], color=PLATES, lw=2.5)
    ax.plot([6.8, 6.8, 0.6], [2.3, 1, 1], **wire)
    for y in (1, 4):
        ax.plot(0.6, y, "o", color="0.2", ms=6, mfc="white", zorder=3)
    arrow = {"arrowstyle": "-|>", "color": "0.2"}
    ax.annotate("", (1.7, 4), (1.0, 4), arrowprops=arrow)
    ax.annotate("", (0.6, 1.25), (0.6, 3.75), arrowprops={**arrow, "color": "0.55"})
    ax.text(1.35, 4.25, "i = y", ha="center")
    ax.text(0.45, 2.5, "v = u", ha="right", va="center")
    ax.text(1.0, 2.5, "port: v i watt\ninto the circuit", color="0.35", va="center")
    ax.text(2.8, 4.65, "coil: flux", color=COIL, ha="center")
    ax.text(5.1, 4.45, "R", color=LOST, ha="center")
    ax.text(6.15, 2.45, "capacitor:\ncharge q", color=PLATES, ha="right", va="center")
    ax.set(xlim=(-0.8, 7.6), ylim=(0.6, 5.2), title="declare it: energies, structure, loss, port")
    ax.axis("off")


def _slope(ax: Any) -> None:
    """Energy of the coil with the tangent at the start of a long step and the chord over it."""
    h = 1e-2
    before, after, _ = step(h)
    flux = np.linspace(0.05, 0.25, 200)
    curve = energies(np.vstack([flux, flux]))[0]
    ends = np.array([before[0], after[0]])
    high = energies(np.vstack([ends, ends]))[0]
    slope = (high[1] - high[0]) / (ends[1] - ends[0])
    near = energies(np.vstack([before[0] + [-1e-6, 1e-6]] * 2))[0]
    tangent = (near[1] - near[0]) / 2e-6
    ax.plot(flux, curve, color=COIL, lw=1.8)
    reach = np.array([0.06, 0.225])
    ax.plot(reach, high[0] + tangent * (reach - ends[0]), color="0.6", lw=1.2, ls="--")
    ax.plot(ends, high, "o-", color=LOST, lw=1.6, ms=5)
    for x, y, name in zip(ends, high, ("start", "end"), strict=True):
        ax.annotate(name, (x, y), (6, -13), textcoords="offset points")
    ax.text(0.205, 0.172, "H of the coil", color=COIL, ha="right")
    ax.annotate(f"slope of the step: {slope:.2f} A", (ends.mean(), high.mean()), (-128, 40), textcoords="offset points",
                color=LOST, arrowprops={"arrowstyle": "-", "color": LOST})  # fmt: skip
    ax.annotate(f"slope at the start: {tangent:.2f} A", (0.2, high[0] + tangent * 0.1), (-52, -34),
                textcoords="offset points", color="0.4")  # fmt: skip
    ax.set(xlabel="flux in Wb", ylabel="energy in J", xlim=(0.05, 0.24), ylim=(0, 0.19),
           title=f"step: slope between the ends (h = {1e3 * h:g} ms, drawn large)")  # fmt: skip


def _energy(ax: Any) -> None:
    """Sources and destinations of the energy of one step."""
    before, after, book = step(STEP)
    coil, plates = (1e3 * float(b - a) for a, b in zip(energies(before), energies(after), strict=True))
    lost, supplied = 1e3 * book["dissipated"], 1e3 * book["supplied"]
    ax.barh(1, supplied, color="0.75", height=0.5)
    ax.text(supplied / 2, 1, f"supplied: h v i = {supplied:.2f}", ha="center", va="center")
    left = 0.0
    for size, colour, label in ((coil, COIL, "coil"), (plates, PLATES, "capacitor")):
        ax.barh(0, size, left=left, color=colour, height=0.5)
        ax.text(left + size / 2, 0, f"{label} {size:.2f}", ha="center", va="center", color="white")
        left += size
    ax.barh(0, lost, left=left, color=LOST, height=0.5)
    ax.annotate(f"lost in R: {lost:.2f}", (left + lost / 2, -0.25), (-52, -20), textcoords="offset points", color=LOST)
    residual = abs(book["stored"] + book["dissipated"] - book["supplied"])
    ax.set(yticks=[], ylim=(-0.75, 1.5), xlabel="energy of one step of 2 ms in mJ",
           title=f"balance of one step; residual {residual:.0g} J")  # fmt: skip
    ax.spines["left"].set_visible(False)


def pair() -> Result:
    """The circuit coupled with the bank of the page, 0.2 s."""
    net = Network("pair")
    net.add("circuit", circuit())
    net.add("bank", declared("understand/mental-model.md", "bank")())
    net.connect("circuit.terminal", "bank.terminal", name="node")
    members = []
    for name, declaration in net.members.items():
        model = build_model(declaration)
        members.append(EngineMember(name, model, NativeInstance(model)))
    return run(Coupled(net, members), Options(stop=0.2, step=STEP))


def _ledger(ax: Any) -> None:
    """All energy of the coupled pair, stacked: its sum does not change."""
    r = pair()
    t = 1e3 * r.time
    coil, plates = energies(np.vstack([r.column("circuit.flux"), r.column("circuit.q")]))
    rows = [coil, plates, r.column("bank.energy.stored"), r.column("circuit.energy.dissipated"),
            r.column("bank.energy.dissipated")]  # fmt: skip
    ax.stackplot(t, rows, colors=(COIL, PLATES, BANK, LOST, LEAK), lw=0)
    total = sum(rows)
    ax.plot(t, total, color="0.1", lw=1.4)
    places = ((6, 0.016, "coil"), (20, 0.12, "capacitor"), (52, 0.08, "bank"), (130, 0.087, "lost in R"),
              (120, 0.17, "lost in the leak"))  # fmt: skip
    for x, y, label in places:
        ax.text(x, y, label, color="white", ha="center", va="center")
    ax.set(xlabel="time in ms", ylabel="energy in J", xlim=(0, 200), ylim=(0, 0.31),
           title=f"ledger of the coupled pair: the sum stays to {np.ptp(total):.0e} J")  # fmt: skip
