"""Derivatives of measures: against differences of the measures of whole runs."""

from __future__ import annotations

import numpy as np
import pytest

from phfmu import Event, NativeInstance, Options, build_model, default_scheme, gradient, run
from phfmu.components.library import build
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.sweeps.measures import measures
from tests.derivatives.differences import richardson
from tests.wide import wide

pytestmark = pytest.mark.usefixtures("compiler")

OF = {
    "dc_motor": [
        "max(terminal.i)",
        "mean(shaft.speed)",
        "rms(terminal.i)",
        "last(energy.dissipated)",
        "min(terminal.i)",
    ],
    "smib": ["peak(gen.I[1])", "last(gen.field.energy)", "last(line.energy.dissipated)", "mean(bus1.v[1])"],
    "four_particle": ["peak(q[7])", "last(energy.dissipated)", "rms(v[1])"],
}
BY = {"dc_motor": ["R", "L"], "smib": ["gen.J", "gen.R_f"], "four_particle": ["k13", "alpha"]}
RUNS = {
    "dc_motor": Options(stop=0.1, step=1e-3, events=(Event(0.0, "terminal.v", 12.0),)),
    "smib": Options(stop=0.05, step=1e-3, events=(Event(0.01, "gen.shaft.torque", 2e6),)),
    "four_particle": Options(stop=0.5, step=1e-2),
}


@pytest.mark.parametrize("name", wide(list(OF), "dc_motor"))
def test_gradients_of_measures(name: str) -> None:
    found_of = build(name)
    d = found_of.declaration() if hasattr(found_of, "declaration") else found_of
    model = build_model(d, default_scheme(d, 2))
    found = gradient(model, NativeInstance(model), RUNS[name], OF[name], BY[name])
    starts = {n: x for v in d.parameters for n, x in zip(v.names(), v.start, strict=True)}
    for j, own in enumerate(found.names):

        def values(x: float, own: str = own) -> np.ndarray:
            m = build_model(d.with_starts({own: x}), default_scheme(d, 2))
            r = run(Monolithic(m, NativeInstance(m)), RUNS[name])
            return np.array([w.of(r.time, r.column(w.signal)) for w in measures(OF[name], r.names)])

        slopes = richardson(values, starts[own], 1e-3 * starts[own])
        scale = np.maximum(np.abs(slopes), 1e-4 * np.abs(found.values) / starts[own] + 1e-12)
        assert (np.abs(found.slopes[:, j] - slopes) / scale).max() < 1e-6, (own, found.slopes[:, j], slopes)


def test_what_is_measured_is_named() -> None:
    model = build_model(build("dc_motor"))
    instance = NativeInstance(model)
    found = gradient(model, instance, RUNS["dc_motor"], ["max(terminal.*)"], ["R"])
    assert found.measures[0] == "max(terminal.i)" and found.by("max(terminal.i)", "R") == found.slopes[0, 0] < 0
    with pytest.raises(ValueError, match=r"tmax\(terminal.i\) is the time of a row"):
        gradient(model, instance, RUNS["dc_motor"], ["tmax(terminal.i)"], ["R"])
