"""The arm Panda of Franka Emika from the numbers of its URDF beside MuJoCo; one of its links has a direction nearly without mass.

Source: panda.urdf of franka_description (Apache licence), as in the package example-robot-data 6.0.0; without fingers and limits.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phfmu import Monolithic, NativeInstance, Options, build_model, check, default_scheme, run
from phfmu.components.mechanical.multibody import mechanism_of_file
from tests.wide import slow

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed (pip install mujoco)")

#: mass [kg], centre of mass [m], xx, xy, xz, yy, yz, zz [kg.m2] of links 1 to 7 and of the hand
LINKS = (
    (4.970684, (0.003875, 0.002081, -0.04762), (0.70337, -0.000139, 0.006772, 0.70661, 0.019169, 0.009117)),
    (0.646926, (-0.003141, -0.02872, 0.003495), (0.007962, -0.003925, 0.010254, 0.02811, 0.000704, 0.025995)),
    (3.228604, (0.027518, 0.039252, -0.066502), (0.037242, -0.004761, -0.011396, 0.036155, -0.012805, 0.01083)),
    (3.587895, (-0.05317, 0.104419, 0.027454), (0.025853, 0.007796, -0.001332, 0.019552, 0.008641, 0.028323)),
    (1.225946, (-0.011953, 0.041065, -0.038437), (0.035549, -0.002117, -0.004037, 0.029474, 0.000229, 0.008627)),
    (1.666555, (0.060149, -0.014117, -0.010517), (0.001964, 0.000109, -0.001158, 0.004354, 0.000341, 0.005433)),
    (0.735522, (0.010517, -0.004252, 0.061597), (0.012516, -0.000428, -0.001196, 0.010027, -0.000741, 0.004815)),
    (0.73, (-0.01, 0.0, 0.03), (0.001, 0.0, 0.0, 0.0025, 0.0, 0.0017)),
)
#: place [m] and turn about x and z [rad] of each link in the frame of the one before
FRAMES = (
    ((0.0, 0.0, 0.333), 0.0, 0.0), ((0.0, 0.0, 0.0), -np.pi / 2, 0.0), ((0.0, -0.316, 0.0), np.pi / 2, 0.0),
    ((0.0825, 0.0, 0.0), np.pi / 2, 0.0), ((-0.0825, 0.384, 0.0), -np.pi / 2, 0.0), ((0.0, 0.0, 0.0), np.pi / 2, 0.0),
    ((0.088, 0.0, 0.0), np.pi / 2, 0.0), ((0.0, 0.0, 0.107), 0.0, -np.pi / 4),
)  # fmt: skip
POSE = [0.3, -0.4, 0.5, -1.8, 0.2, 1.6, 0.7]
STOP = 1.0


def urdf(extra: str = "") -> str:
    """The arm that falls from its pose, with 0.003 N.m.s/rad in each joint; `extra`: for MuJoCo."""
    parts = [f'<robot name="panda">{extra}<link name="base"/>']
    for i, ((mass, com, j), (at, about_x, about_z)) in enumerate(zip(LINKS, FRAMES, strict=True), 1):
        before, kind = ("base" if i == 1 else f"link{i - 1}"), ("fixed" if i == len(LINKS) else "continuous")
        moments = " ".join(f'i{name}="{v}"' for name, v in zip(("xx", "xy", "xz", "yy", "yz", "zz"), j, strict=True))
        parts.append(
            f'<link name="link{i}"><inertial><origin xyz="{com[0]} {com[1]} {com[2]}"/><mass value="{mass}"/>'
            f'<inertia {moments}/></inertial></link><joint name="joint{i}" type="{kind}"><parent link="{before}"/>'
            f'<child link="link{i}"/><origin xyz="{at[0]} {at[1]} {at[2]}" rpy="{about_x!r} 0 {about_z!r}"/>'
            f'<axis xyz="0 0 1"/><dynamics damping="0.003"/></joint>'
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
