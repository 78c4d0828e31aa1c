"""Section 6.3 as files: figures 3 to 6 as PNG with the plotted numbers as CSV beside them, table 1, the statements."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from phfmu.discretise.model import Model
from phfmu.studies.bench.paper import (
    STEPS,
    PaperRun,
    Statement,
    convergence,
    four_particle_models,
    large_steps,
    simulate,
    statements,
)
from phfmu.studies.figures import pyplot, save

FLOOR = 1e-18  # zero on a logarithmic axis


def write(declaration: Any, folder: str | Path) -> list[Statement]:
    """Figures 3 to 6 (PNG and CSV), table 1 and the statements into `folder`; needs matplotlib."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    models = four_particle_models(declaration)
    draw(models, folder)
    found = statements(models)
    lines = ["holds,number,statement,remark"]
    lines += [f'{"yes" if s.holds else "no"},{s.number:.6g},"{s.text}","{s.remark}"' for s in found]
    (folder / "statements.csv").write_text("\n".join(lines) + "\n")
    return found


def draw(models: dict[str, Model], folder: Path) -> None:
    """All figures and the table into `folder`."""
    dg, mp = (simulate(models[k], 0.01, 10.0) for k in ("DG", "MP"))
    free, free_mp = (simulate(models[k], 0.01, 10.0) for k in ("DG undamped", "MP undamped"))
    _figure_3(dg, mp, folder)
    _figure_4(dg, folder)
    _figure_5(free, free_mp, folder)
    _figure_6(models, folder)
    _table_1(models["DG"], folder)


def _csv(path: Path, columns: dict[str, Any]) -> None:
    n = max(len(np.atleast_1d(v)) for v in columns.values())
    rows = [np.concatenate([np.ravel(v), np.full(n - np.size(v), np.nan)]) for v in columns.values()]
    np.savetxt(path, np.column_stack(rows), "%.17g", ",", header=",".join(columns), comments="")


def _axes(n: int) -> tuple[Any, Any]:
    plt = pyplot()

    plt.rcParams.update({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "lines.linewidth": 1.2})
    return plt.subplots(1, n, figsize=(4.2 * n, 3.1), layout="constrained")


def _figure_3(dg: PaperRun, mp: PaperRun, folder: Path) -> None:
    figure, (a, b, c) = _axes(3)
    a.plot(dg.t, dg.H)
    a.set(xlabel="t in s", ylabel="H in J", title="Hamiltonian, DG")
    b.plot(dg.t[1:], dg.dH, label=r"$\Delta H$")
    b.plot(dg.t[1:], dg.dissipated, label=r"$W_{diss}$")
    b.plot(dg.t[1:], dg.dH + dg.dissipated, "k--", label="sum")
    b.set(xlabel="t in s", ylabel="J per step", title="increments, DG")
    b.legend()
    for run, name in ((dg, "DG"), (mp, "MP")):
        c.semilogy(run.t[1:], np.maximum(np.abs(run.dH + run.dissipated), FLOOR), label=name)
    c.set(xlabel="t in s", ylabel=r"$|\Delta H + W_{diss}|$ in J", title="power balance per step")
    c.legend()
    save(figure, folder / "figure_3.png")
    sums = {"residual_DG": dg.dH + dg.dissipated, "residual_MP": mp.dH + mp.dissipated}
    _csv(folder / "figure_3.csv", {"t": dg.t[1:], "H_DG": dg.H[1:], "dH_DG": dg.dH, "W_DG": dg.dissipated, **sums})


def _figure_4(dg: PaperRun, folder: Path) -> None:
    figure, axes = _axes(2)
    for axis, rows, title in zip(
        axes, (dg.g, dg.dgv), ("position level, $g_i(q)$", "velocity level, $Dg_i(q)\\,v$"), strict=True
    ):
        for i in range(rows.shape[1]):
            axis.plot(dg.t[1:], rows[:, i], label=f"i = {i + 1}")
        axis.set(xlabel="t in s", title=title)
        axis.legend()
    save(figure, folder / "figure_4.png")
    columns = (
        {"t": dg.t[1:]} | {f"g{i + 1}": dg.g[:, i] for i in range(2)} | {f"Dgv{i + 1}": dg.dgv[:, i] for i in range(2)}
    )
    _csv(folder / "figure_4.csv", columns)


def _figure_5(dg: PaperRun, mp: PaperRun, folder: Path) -> None:
    figure, (a, b) = _axes(2)
    for run, name in ((mp, "MP"), (dg, "DG")):
        a.plot(run.t, run.H, label=name)
        b.semilogy(run.t[1:], np.maximum(np.abs(run.dH), FLOOR), label=name)
    a.set(xlabel="t in s", ylabel="H in J", title=r"Hamiltonian, $\eta_0 = 0$")
    a.ticklabel_format(useOffset=False)
    b.set(xlabel="t in s", ylabel=r"$|\Delta H|$ in J", title="increments")
    a.legend()
    b.legend()
    save(figure, folder / "figure_5.png")
    _csv(folder / "figure_5.csv", {"t": dg.t[1:], "H_DG": dg.H[1:], "dH_DG": dg.dH, "H_MP": mp.H[1:], "dH_MP": mp.dH})


def _figure_6(models: dict[str, Model], folder: Path) -> None:
    figure, (a, b) = _axes(2)
    table, large = convergence(models), large_steps(models)
    for scheme, style in (("DG", "o-"), ("MP", "x--")):
        for label, errors in table[scheme].items():
            a.loglog(STEPS, errors, style, label=f"{scheme} {label}")
    a.set(xlabel="h in s", ylabel="relative error at t = 0.1 s", title="convergence")
    a.legend(fontsize=7, ncols=2)
    for (scheme, h), run in large.items():
        if run is not None:
            b.plot(run.t, run.H, "-" if scheme == "DG" else "--", label=f"{scheme}, h = {h:g}")
    b.set(xlabel="t in s", ylabel="H in J", title="large steps", ylim=(0.4, 2.2))
    b.legend(fontsize=7, ncols=2)
    save(figure, folder / "figure_6.png")
    errors = {f"{s}_{q}": e for s, part in table.items() for q, e in part.items()}
    _csv(folder / "figure_6_errors.csv", {"h": np.array(STEPS)} | errors)
    lines = ["scheme,h,completed,H_end,rises,largest_rise"]
    for (scheme, h), run in large.items():
        last = "no,,," if run is None else f"yes,{run.H[-1]:.6g},{int((run.dH > 1e-12).sum())},{run.dH.max():.3g}"
        lines.append(f"{scheme},{h:g},{last}")
    (folder / "figure_6_large_steps.csv").write_text("\n".join(lines) + "\n")


def _table_1(model: Model, folder: Path) -> None:
    names = [n for v in model.declaration.parameters for n in v.names()]
    rows = ["parameter,value", "h,0.01", "t_end,10"] + [f"{n},{v:.17g}" for n, v in zip(names, model.p0, strict=True)]
    (folder / "table_1.csv").write_text("\n".join(rows) + "\n")
