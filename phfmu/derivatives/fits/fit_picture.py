"""A picture of a fit: measurements, the run that was found, and residuals."""

from phfmu.derivatives.fits.fit import Fit
from phfmu.report.picture.picture import Picture, panel
from phfmu.report.recording import Signal


def picture_of(found: Fit) -> Picture:
    """Two axes for each signal and experiment: measurements with the fit, and residuals, to a scale of their own."""
    panels = []
    for experiment, name, t, data, model in found.curves:
        unit = found.units.get(name)
        both = [Signal(name, unit, t, data, label="measured", points=True), Signal(name, unit, t, model, label="fit")]
        panels.append(panel(f"{name} ({experiment})", both))
        left = Signal(name, unit, t, model - data, label="fit - measured", points=True)
        panels.append(panel(f"residual of {name}", [left]))
    values = ", ".join(f"{n} = {v:.6g}" for n, v in found.values.items())
    return Picture(f"Fit of {values}", tuple(panels))
