"""The scene with the arm Panda beside the same arm of a file, and beside MuJoCo's that its motors move."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import Monolithic, NativeInstance, Options, build_model, default_scheme, run
from phfmu.components.mechanical.multibody import mechanism_of_file
from phfmu.components.scenes.mechanical.panda import FRICTION, PUSHES, READY, TOOL, panda, panda_arm
from tests.importers.test_panda import mujoco, urdf
from tests.wide import slow

NAMES = [f"joint{i}" for i in range(1, 8)]


def test_the_hand_is_welded_to_the_last_link_as_mujoco_does(tmp_path: Path) -> None:
    """Centres, directors and masses of all bodies in the pose of the start are those of the file."""
    path = tmp_path / "panda.urdf"
    path.write_text(urdf(friction=FRICTION))
    read, made = mechanism_of_file(path, qpos=list(READY)).build(), panda_arm(damping=FRICTION)
    for name in ("q", "m"):
        a, b = (next(v for v in (*d.states, *d.parameters) if v.name == name).start for d in (read, made))
        # a director and its opposite are one axis of a body
        assert np.abs(a) == pytest.approx(np.abs(b), rel=1e-9, abs=1e-9)


@cache
def peer(steps: int) -> dict[str, np.ndarray]:
    """Angles and the tool at the end of the scene by MuJoCo's RK4, and what each motor did, its torque times its angle."""
    compiler = '<mujoco><compiler balanceinertia="false" fusestatic="true"/></mujoco>'
    model = mujoco.MjModel.from_xml_string(urdf(compiler, FRICTION))
    model.opt.timestep, model.opt.integrator = 1.0 / steps, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    data.qpos[:] = READY
    mujoco.mj_forward(model, data)
    held, work = data.qfrc_bias.copy(), np.zeros(7)
    push = np.array([PUSHES.get(name, 0.0) for name in NAMES])
    for part, sign in ((0.1, 0.0), (0.25, 1.0), (0.25, -1.0), (0.4, 0.0)):
        before = data.qpos.copy()
        data.qfrc_applied[:] = held + sign * push
        mujoco.mj_step(model, data, round(part * steps))
        work += data.qfrc_applied * (data.qpos - before)
    mujoco.mj_forward(model, data)
    last = model.body("link7").id
    tool = data.xpos[last] + data.xmat[last].reshape(3, 3) @ TOOL
    return {"angle": data.qpos.copy(), "tool": tool, "work": work, "held": held}


@pytest.mark.parametrize(("order", "step", "most"), [(2, 2e-3, 2e-3), slow((6, 2e-3, 1e-8))])
def test_the_scene_is_carried_moved_and_stopped_as_in_mujoco(order: int, step: float, most: float) -> None:
    """Each motor books its torque times the angle by which its joint turns; all steps are taken by the Schur stepper."""
    expected = peer(20_000)
    rounding = max(np.abs(expected[what] - peer(10_000)[what]).max() for what in ("angle", "tool", "work"))
    assert rounding < most / 20
    scene = panda()
    declaration = scene.declaration()
    assert [float(p.start[0]) for p in declaration.ports] == pytest.approx(expected["held"], abs=1e-9)  # type: ignore[index]
    model = build_model(declaration, default_scheme(declaration, order))
    instance = NativeInstance(model)
    found: Any = run(Monolithic(model, instance), Options(stop=scene.stop, step=step, events=scene.events))
    assert instance.counts["schur"] == instance.counts["solves"]
    gap = np.array([found.column(f"{n}.angle")[-1] for n in NAMES]) - expected["angle"]
    assert np.abs(np.angle(np.exp(1j * gap))).max() <= most
    assert np.array([found.column(f"tool[{i}]")[-1] for i in (1, 2, 3)]) == pytest.approx(expected["tool"], abs=most)
    total = found.ledger.summary()
    supplied = {p.port: p.supplied for p in total.ports}
    works = np.array([supplied[n] for n in NAMES])
    assert works == pytest.approx(expected["work"], abs=most * np.abs(works).max())
    assert total.closed and abs(total.network.unexplained) <= 1e-12 * np.abs(works).sum()
    assert total.network.dissipated > 0.1


def test_a_pose_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match=r"panda: pose needs 7 finite numbers, got \[0.1, 0.2\]"):
        panda_arm((0.1, 0.2))
