"""Parameters that events change while switches conduct: the constraints of the present mode hold after them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phfmu import (
    Collocated,
    Coupled,
    EngineMember,
    Event,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    SwitchedInstance,
    build_model,
    run,
)
from phfmu.components.library import build
from phfmu.engine.switched import stepped
from tests.wide import wide

LS, LL = 2e-3, 20e-3
CHANGED = {"grid.L": 2 * LS, "load.L": LL / 5}


def test_an_inductance_that_changes_while_diodes_conduct_keeps_the_currents_of_the_mode():
    """One current in both: i = (sum of fluxes)/(sum of inductances) after it, and one until the diodes commutate."""
    scene, when = build("rectifier"), 0.0215
    model = build_model(scene.declaration(), Collocated(2))
    events = (Event(when, "grid.L", 2 * LS),)
    result = run(
        Monolithic(model, SwitchedInstance(model, NativeInstance)), Options(stop=0.0235, step=5e-4, events=events)
    )
    grid, load = result.column("grid.current"), result.column("load.current")
    before, after = np.flatnonzero(np.isclose(result.time, when, rtol=0, atol=1e-12))[0], slice(-2, None)
    assert np.abs(np.abs(grid[after]) - load[after]).max() < 1e-9
    assert result.ledger.summary().closed
    (note,) = (n for n in result.notes if n.startswith("projected at"))
    i, flux = load[before], (LS + LL) * load[before]
    j = flux / (2 * LS + LL)
    lost = ((LS / 2 + LL) * i**2 - (2 * LS + LL) * j**2) / 2
    assert float(note.split("changed by ")[1].split(" J")[0]) == pytest.approx(-lost, rel=1e-8)


@pytest.mark.parametrize("name", wide(["grid.L", "load.L"], "grid.L"))
def test_members_apart_do_what_the_composed_run_does(name):
    """The constraints of the present mode span members: a loop of two inductances is of two of them."""
    options = Options(stop=0.0235, step=5e-4, events=(Event(0.0215, name, CHANGED[name]),))
    network = build("rectifier").system
    assert isinstance(network, Network)
    model = build_model(build("rectifier").declaration(), Collocated(2))
    composed = run(Monolithic(model, SwitchedInstance(model, NativeInstance)), options)
    models = {n: build_model(replace(d, name=n), Collocated(2)) for n, d in network.declared.items()}
    members = [EngineMember(n, m, stepped(m, NativeInstance)) for n, m in models.items()]
    apart = run(Coupled(network, members), options)
    for column in ("grid.current", "load.current"):
        assert apart.column(column) == pytest.approx(composed.column(column), rel=1e-10, abs=1e-9)
    assert apart.ledger.summary().closed
    assert [n for n in apart.notes if "projected" in n] == [n for n in composed.notes if "projected" in n] != []
