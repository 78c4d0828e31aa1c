"""Random trees of bodies, hinges, sliders and balls beside MuJoCo at tiny steps, in every engine and unit."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import Monolithic, NativeInstance, Options, PythonInstance, build_model, check, default_scheme, export, run
from phfmu.components.mechanical.multibody import mechanism_of_file

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed (pip install mujoco)")
pytestmark = pytest.mark.slow

STOP, H = 0.25, 2.0**-8
SEEDS = range(12)


def tree(seed: int) -> tuple[str, list[float], list[float]]:
    """An MJCF of 2 to 4 bodies in turned frames, with damping and armature of some joints, qpos and qvel."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 5))
    parents = [-1] + [int(rng.integers(-1, i)) for i in range(1, n)]
    bodies, qpos, qvel = ["" for _ in range(n)], [[] for _ in range(n)], [[] for _ in range(n)]

    def words(values: Any) -> str:
        return " ".join(f"{v:.12g}" for v in values)

    for i in range(n):
        kind = rng.choice(["hinge", "hinge", "slide", "ball"])
        turn, own, axis = rng.normal(size=4), rng.normal(size=4), rng.normal(size=3)
        spread = np.sort(rng.uniform(0.01, 0.05, 3))  # second moments, so that the triangle inequality holds
        moments = [spread[1] + spread[2], spread[0] + spread[2], spread[0] + spread[1]]
        extra = f' damping="{rng.uniform(0, 0.2):.3f}"' if kind != "ball" and rng.random() < 0.5 else ""
        extra += f' armature="{rng.uniform(0.01, 0.1):.3f}"' if kind != "ball" and rng.random() < 0.3 else ""
        direction = "" if kind == "ball" else f' axis="{words(axis)}"'
        bodies[i] = (
            f'<body name="b{i}" pos="{words(rng.uniform(-0.5, 0.5, 3))}" quat="{words(turn / np.linalg.norm(turn))}">'
            f'<joint name="j{i}" type="{kind}" pos="{words(rng.uniform(-0.1, 0.1, 3))}"{direction}{extra}/>'
            f'<inertial pos="{words(rng.uniform(-0.3, 0.3, 3))}" quat="{words(own / np.linalg.norm(own))}" '
            f'mass="{rng.uniform(0.5, 2):.3f}" diaginertia="{words(moments)}"/>'
        )
        unit = rng.normal(size=4)
        qpos[i] = (unit / np.linalg.norm(unit)).tolist() if kind == "ball" else [float(rng.uniform(-1, 1))]
        qvel[i] = rng.uniform(-2, 2, 3 if kind == "ball" else 1).tolist()

    order: list[int] = []

    def nested(parent: int) -> str:
        out = ""
        for i in range(n):
            if parents[i] == parent:
                order.append(i)
                out += bodies[i] + nested(i) + "</body>"
        return out

    text = f'<mujoco model="tree"><option gravity="0 0 -9.81"/><worldbody>{nested(-1)}</worldbody></mujoco>'
    return text, [x for i in order for x in qpos[i]], [x for i in order for x in qvel[i]]


@cache
def exact(seed: int) -> dict[str, np.ndarray]:
    """Places of the centres of mass and rotations by MuJoCo's RK4 in 20 000 steps."""
    text, qpos, qvel = tree(seed)
    model = mujoco.MjModel.from_xml_string(text)
    steps = 20000
    model.opt.timestep, model.opt.integrator = STOP / steps, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_step(model, data, steps)
    mujoco.mj_forward(model, data)
    bodies = range(1, model.nbody)
    out = {f"{model.body(b).name}.position": data.xipos[b].copy() for b in bodies}
    return out | {f"{model.body(b).name}.rotation": data.xmat[b].reshape(3, 3).T.ravel().copy() for b in bodies}


def model_of(seed: int, order: int, folder: Path) -> Any:
    text, qpos, qvel = tree(seed)
    path = folder / "tree.xml"
    path.write_text(text)
    declaration = mechanism_of_file(path, qpos=qpos, qvel=qvel).build()
    assert not check(declaration)
    return build_model(declaration, default_scheme(declaration, order))


def missed(seed: int, model: Any, engine: Any = NativeInstance, step: float = H) -> tuple[float, Any]:
    """Largest difference from MuJoCo at the end, and the run; its ledger is closed."""
    found = run(Monolithic(model, engine(model)), Options(stop=STOP, step=step))
    total = found.ledger.summary()
    assert total.closed and total.network is not None and abs(total.network.unexplained) <= 1e-11
    gaps = [
        abs(found.column(f"{name}[{i + 1}]")[-1] - v)
        for name, values in exact(seed).items()
        for i, v in enumerate(values)
    ]
    return max(gaps), found


@pytest.mark.parametrize("seed", SEEDS)
def test_order_six_ends_where_mujoco_ends(seed: int, tmp_path: Path) -> None:
    gap, found = missed(seed, model_of(seed, 6, tmp_path), step=H / 2)
    assert gap <= 1e-9
    assert found.ledger.summary().components[0].worst_relative <= 1e-11


@pytest.mark.parametrize("seed", SEEDS)
def test_order_two_goes_with_the_square_of_the_step(seed: int, tmp_path: Path) -> None:
    model = model_of(seed, 2, tmp_path)
    coarse, fine = (missed(seed, model, step=h)[0] for h in (H / 4, H / 8))
    assert 1.7 < np.log2(coarse / fine) < 2.3 and fine <= 1e-3


@pytest.mark.parametrize("order", [2, 6])
@pytest.mark.parametrize("seed", list(SEEDS)[:4])
def test_engines_and_units_agree(seed: int, order: int, tmp_path: Path) -> None:
    """Times in steps of 1/256 s are exact, so that a unit in FMPy has the bits of the native engine."""
    from fmpy import simulate_fmu

    model = model_of(seed, order, tmp_path)
    gap, native = missed(seed, model)
    by_python, python = missed(seed, model, PythonInstance)
    names = [f"{name}[{i + 1}]" for name, v in exact(seed).items() for i in range(len(v))]
    assert max(abs(native.column(n)[-1] - python.column(n)[-1]) for n in names) <= 1e-10
    assert abs(gap - by_python) <= 1e-10
    for unit in export(model, tmp_path, versions=("2.0", "3.0"), step=H):
        rows = simulate_fmu(str(unit), stop_time=STOP, output_interval=H, output=names)
        assert all(rows[n][-1] == native.column(n)[-1] for n in names)


@pytest.mark.parametrize("order", [2, 6])
@pytest.mark.parametrize("seed", list(SEEDS)[:4])
def test_ten_times_as_long_the_balance_closes(seed: int, order: int, tmp_path: Path) -> None:
    model = model_of(seed, order, tmp_path)
    found = run(Monolithic(model, NativeInstance(model)), Options(stop=10 * STOP, step=H / 2))
    total = found.ledger.summary()
    assert total.closed and total.network is not None and abs(total.network.unexplained) <= 1e-10
    for name in {n.split(".")[0] for n in exact(seed)}:
        turn = np.array([found.column(f"{name}.rotation[{i + 1}]")[-1] for i in range(9)]).reshape(3, 3)
        assert np.abs(turn @ turn.T - np.eye(3)).max() <= 1e-10
