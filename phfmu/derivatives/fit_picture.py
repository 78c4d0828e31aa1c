"""A picture of a fit: measurements, the run that was found, and what is left."""

from __future__ import annotations

from typing import TYPE_CHECKING

from phfmu.report.picture.extra import require

if TYPE_CHECKING:
    from phfmu.derivatives.fit import Fit

DPI, WIDTH, HEIGHT = 100, 1100, 320


def draw_fit(found: Fit, path: str) -> None:
    """A row for each signal and experiment: measurements with the fit, and below it what is left, to a scale of its own.

    Errors: ValueError without matplotlib; OSError where it cannot be written.
    """
    require("matplotlib")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    n = len(found.curves)
    figure = Figure(figsize=(WIDTH / DPI, (60 + HEIGHT * n) / DPI), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2 * n, 1, gridspec_kw={"height_ratios": [2, 1] * n}, squeeze=False)[:, 0]
    for (name, signal, t, data, model), above, below in zip(found.curves, axes[::2], axes[1::2], strict=True):
        above.plot(t, data, ".", ms=3, color="0.45", label="measured")
        above.plot(t, model, "-", lw=1.2, color="C0", label="fit")
        above.set_title(f"{signal}  ({name})", fontsize=9, loc="left")
        above.legend(fontsize=8, loc="best")
        below.axhline(0.0, lw=0.6, color="0.7")
        below.plot(t, model - data, ".", ms=3, color="C3")
        below.set_ylabel("residual", fontsize=8)
        for a in (above, below):
            a.tick_params(labelsize=8)
            a.grid(alpha=0.3)
        above.tick_params(labelbottom=False)
    if n:
        axes[-1].set_xlabel("time in s", fontsize=8)
    figure.savefig(path)
