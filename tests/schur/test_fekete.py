"""Every pair of twenty charges on a sphere: a dense model keeps the fast stepper, and its published solution."""

from __future__ import annotations

import numpy as np
import pytest

from phfmu.components.mechanical.fekete import fekete
from phfmu.components.mechanical.multibody import Multibody
from phfmu.discretise.model import Model, build_model, default_scheme
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.reference.python import PythonInstance

#: positions of the first two charges at t = 1000 s, in m: Mazzia, Magherini, Test Set for IVP Solvers (2008)
PUBLISHED = (-0.4070263380333202, 0.3463758772791802, 0.8451942450030429, 0.0775293475252155, -0.2628662719972299,
             0.9617122871829146)  # fmt: skip


@pytest.fixture(scope="module")
def charges() -> Model:
    declaration = fekete()
    return build_model(declaration, default_scheme(declaration, 6))


@pytest.mark.slow
def test_a_thousand_seconds_end_at_the_published_positions(charges: Model, compiler: None) -> None:
    unit = NativeInstance(charges)
    rows = unit.run(0.0, 0.1, 10_000, ["stored", "dissipated", "supplied"])
    assert unit.counts["schur"] == 10_000
    assert np.abs(unit.x[:6] - PUBLISHED).max() <= 1e-8
    residual = rows["stored"] + rows["dissipated"] - rows["supplied"]
    assert np.abs(residual).max() <= 1e-13


def test_all_rows_are_left_to_newton_where_they_cost_more(charges: Model, compiler: None) -> None:
    """190 springs between 60 coordinates: stiff ones fall back to Newton, with the same solution."""
    schur = charges.step.schur
    assert schur is not None and schur.nstrain == 190 and schur.soft is None and schur.hard.n == 20
    fast, slow = NativeInstance(charges), PythonInstance(charges)
    names = [n for v in charges.declaration.parameters for n in v.names()]
    p = charges.p0.copy()
    p[names.index("c")] = 3e3
    for unit in (fast, slow):
        unit.set_parameters(p)
        unit.run(0.0, 0.01, 2)
    assert fast.counts["factored"] > 0 and np.abs(fast.x - slow.x).max() <= 1e-10


@pytest.mark.slow
def test_a_tangle_of_bars_is_eliminated_as_a_block(compiler: None) -> None:
    """Bars between random pairs fill the factor up; the cluster turns as one body about its centre of mass."""
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.0, 1.0, (60, 3))
    q -= q.mean(axis=0)
    body = Multibody("tangle")
    points = [body.particle(1.0, x, np.cross([0.0, 0.0, 2.0], x)) for x in q]
    pairs = {tuple(sorted(rng.choice(60, 2, replace=False))) for _ in range(140)}
    for a, b in sorted(pairs):
        body.bar(points[a], points[b])
    declaration = body.build()
    m = build_model(declaration, default_scheme(declaration, 2))
    schur = m.step.schur
    assert schur is not None and schur.hard.full < schur.hard.n - 40
    fast, slow = NativeInstance(m), PythonInstance(m)
    for unit in (fast, slow):
        unit.run(0.0, 0.01, 3)
    assert fast.counts["schur"] == 3 and np.abs(fast.x - slow.x).max() <= 1e-12
