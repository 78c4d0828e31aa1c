"""The arm Panda of Franka Emika from the numbers of its URDF beside MuJoCo; one of its links has a direction nearly without mass.

Source: panda.urdf of franka_description (Apache licence), as in the package example-robot-data 6.0.0; without fingers and limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from phfmu import Monolithic, NativeInstance, Options, build_model, check, default_scheme, run
from phfmu.components.mechanical.multibody import mechanism_of_file
from phfmu.components.scenes.mechanical.panda import FRAMES, LINKS
from tests.wide import slow

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed (pip install mujoco)")

POSE = [0.3, -0.4, 0.5, -1.8, 0.2, 1.6, 0.7]
STOP = 1.0


def urdf(extra: str = "", friction: Sequence[float] = (0.003,) * 7) -> str:
    """The arm as a file, the hand a link of its own; `extra`: for MuJoCo;  friction [N.m.s/rad] of the joints."""
    parts = [f'<robot name="panda">{extra}<link name="base"/>']
    for i, ((mass, com, j), (at, about_x, about_z)) in enumerate(zip(LINKS, FRAMES, strict=True), 1):
        before, kind = ("base" if i == 1 else f"link{i - 1}"), ("fixed" if i == len(LINKS) else "continuous")
        moments = " ".join(f'i{name}="{v}"' for name, v in zip(("xx", "xy", "xz", "yy", "yz", "zz"), j, strict=True))
        braked = "" if kind == "fixed" else f'<dynamics damping="{friction[i - 1]}"/>'
        parts.append(
            f'<link name="link{i}"><inertial><origin xyz="{com[0]} {com[1]} {com[2]}"/><mass value="{mass}"/>'
            f'<inertia {moments}/></inertial></link><joint name="joint{i}" type="{kind}"><parent link="{before}"/>'
            f'<child link="link{i}"/><origin xyz="{at[0]} {at[1]} {at[2]}" rpy="{about_x!r} 0 {about_z!r}"/>'
            f'<axis xyz="0 0 1"/>{braked}</joint>'
        )
    return "".join([*parts, "</robot>"])


def fallen() -> np.ndarray:
    """Angles of the joints by MuJoCo's RK4 at two steps, extrapolated; the two differ by less than 1e-11."""
    compiler = '<mujoco><compiler balanceinertia="false" fusestatic="true"/></mujoco>'
    model = mujoco.MjModel.from_xml_string(urdf(compiler))
    found = []
    for steps in (50_000, 100_000):
        model.opt.timestep, model.opt.integrator = STOP / steps, mujoco.mjtIntegrator.mjINT_RK4
        data = mujoco.MjData(model)
        data.qpos[:] = POSE
        mujoco.mj_step(model, data, steps)
        found.append(data.qpos.copy())
    assert np.abs(found[1] - found[0]).max() <= 1e-11
    return found[1]


@pytest.mark.parametrize("order, step, most", [(2, 2e-3, 5e-2), slow((6, 1e-3, 1e-8)), slow((6, 5e-4, 1e-10))])
def test_the_arm_falls_as_in_mujoco_by_the_schur_stepper(order: int, step: float, most: float, tmp_path: Path) -> None:
    path = tmp_path / "panda.urdf"
    path.write_text(urdf())
    m = mechanism_of_file(path, qpos=POSE)
    declaration = m.build()
    assert not check(declaration)
    model = build_model(declaration, default_scheme(declaration, order))
    instance = NativeInstance(model)
    found = run(Monolithic(model, instance), Options(stop=STOP, step=step))
    assert instance.counts["schur"] == instance.counts["solves"] == round(STOP / step)
    total = found.ledger.summary()
    assert total.closed and abs(total.network.unexplained) <= 1e-12
    gap = np.array([found.column(f"{j.name}.angle")[-1] for j in m.joints]) - fallen()
    assert np.abs(np.angle(np.exp(1j * gap))).max() <= most
