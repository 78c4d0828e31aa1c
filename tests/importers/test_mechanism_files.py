"""Mechanisms of MJCF and URDF files move as in MuJoCo; what cannot be kept is told in one list."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import Monolithic, NativeInstance, Options, build_model, check, default_scheme, run
from phfmu.components.mechanical.multibody import mechanism_of_file
from tests.wide import slow

mujoco = pytest.importorskip("mujoco")

CART = """<mujoco model="cart pendulum">
  <option gravity="0 0 -9.81" integrator="RK4"><flag contact="disable"/></option>
  <worldbody><body name="cart" pos="0 0 1">
    <joint name="slide" type="slide" axis="1 0 0" damping="0.3" armature="0.2"/>
    <inertial pos="0 0 0" mass="2" diaginertia="0.02 0.03 0.04"/>
    <body name="upper" pos="0 0 0">
      <joint name="hip" type="hinge" axis="0 1 0" damping="0.05" armature="0.1" stiffness="1.5" springref="10"/>
      <inertial pos="0.02 0 -0.3" quat="0.9 0.1 0.3 0" mass="1" diaginertia="0.03 0.028 0.004"/>
      <body name="lower" pos="0 0 -0.6">
        <joint name="knee" type="hinge" axis="0.2 1 0.1" damping="0.02"/>
        <inertial pos="0 0.01 -0.25" mass="0.7" diaginertia="0.02 0.02 0.003"/>
        <body name="tip" pos="0 0 -0.5"><inertial pos="0 0 0" mass="0.2" diaginertia="1e-3 1e-3 1e-3"/></body>
      </body>
    </body>
  </body></worldbody>
  <actuator><motor name="push" joint="slide"/></actuator>
</mujoco>"""

BALLS = """<mujoco model="balls">
  <option gravity="0 0 -9.81" integrator="RK4"><flag contact="disable"/></option>
  <worldbody><body name="first"><joint name="a" type="ball"/>
    <inertial pos="0.5 0 0" mass="1" diaginertia="0.02 0.09 0.1"/>
    <body name="second" pos="1 0 0"><joint name="b" type="hinge" axis="0 1 0"/>
      <inertial pos="0.5 0.1 0" mass="1.1" diaginertia="0.02 0.08 0.09"/></body></body>
  <body name="free" pos="0 2 0"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.2 0.25"/></body></worldbody>
</mujoco>"""

ARM = """<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="3"/>
    <inertia ixx="0.05" iyy="0.05" izz="0.01" ixy="0.002" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="none.stl"/></geometry></visual></link>
  <link name="lower"><inertial><origin xyz="0.05 0 0.2" rpy="0.1 0.2 0.3"/><mass value="2"/>
    <inertia ixx="0.03" iyy="0.03" izz="0.008" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.4"/><axis xyz="1 0 0"/>
    <dynamics damping="0.1"/></joint>
</robot>"""


def moved(path: Path, qpos: list[float], qvel: list[float], stop: float, h: float) -> Any:
    """MuJoCo's data after RK4."""
    text = path.read_text()
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep, model.opt.integrator = h, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_step(model, data, round(stop / h))
    mujoco.mj_forward(model, data)
    return data


CASES = [
    ("cart.xml", CART, [0.1, 0.7, -0.4], [0.3, 1.0, 2.0], 2.5e-3, "lower"),
    ("balls.xml", BALLS, [1, 0, 0, 0, 0.3, 0, 2, 0, 1, 0, 0, 0], [1, 0, 2, 0.5, 0, 0, 1, 1, 4, 0.3], 2.5e-3, "second"),
    ("arm.urdf", ARM, [0.4, -0.3], [1.0, 2.0], 2.5e-3, "lower"),
]


@pytest.mark.parametrize("file, text, qpos, qvel, step, body", [slow(CASES[0]), slow(CASES[1]), CASES[2]])
def test_moves_as_in_mujoco(
    tmp_path: Path, file: str, text: str, qpos: list[float], qvel: list[float], step: float, body: str
) -> None:
    path = tmp_path / file
    path.write_text(text)
    m = mechanism_of_file(path, qpos=qpos, qvel=qvel)
    declaration = m.build()
    assert not check(declaration)
    model = build_model(declaration, default_scheme(declaration, 6))
    stop = 0.25
    found = run(Monolithic(model, NativeInstance(model)), Options(stop=stop, step=step))
    clean = tmp_path / f"clean_{file}"
    clean.write_text(text.replace('<visual><geometry><mesh filename="none.stl"/></geometry></visual>', ""))
    if file.endswith("urdf"):
        clean.write_text(
            clean.read_text().replace("<link name", '<mujoco><compiler balanceinertia="false"/></mujoco><link name', 1)
        )
    data = moved(clean, qpos, qvel, stop, 1.25e-5)
    index = mujoco.mj_name2id(data.model, mujoco.mjtObj.mjOBJ_BODY, body)
    rotation = np.array([found.column(f"{body}.rotation[{i + 1}]")[-1] for i in range(9)]).reshape(3, 3).T
    assert np.abs(rotation - data.xmat[index].reshape(3, 3)).max() <= 1e-10
    assert abs(found.ledger.summary().network.unexplained) <= 1e-11
    for j in m.joints:
        if j.kind in ("revolute", "prismatic"):
            own = found.column(f"{j.name}.{j.equations.coordinates[0].name}")[[0, -1]]
            address = data.model.joint(j.name).qposadr[0]
            assert np.abs(own - (qpos[address], data.qpos[address])).max() <= 1e-10


def test_motors_are_ports(tmp_path: Path) -> None:
    path = tmp_path / "cart.xml"
    path.write_text(CART)
    assert [p.name for p in mechanism_of_file(path).build().ports] == ["slide"]
    assert not mechanism_of_file(path, drop=["actuators"]).build().ports


def test_what_cannot_be_kept_is_told_at_once(tmp_path: Path) -> None:
    path = tmp_path / "rough.xml"
    rough = CART.replace('armature="0.2"', 'armature="0.2" frictionloss="1" range="-1 1"')
    rough = rough.replace(
        "<actuator>", '<tendon><fixed name="t"><joint joint="hip" coef="1"/></fixed></tendon><actuator>'
    )
    rough = rough.replace('<inertial pos="0 0 0" mass="2"', '<geom size="0.1"/><inertial pos="0 0 0" mass="2"')
    path.write_text(rough.replace('<motor name="push" joint="slide"/>', '<position name="push" joint="slide" kp="3"/>'))
    with pytest.raises(ValueError) as told:
        mechanism_of_file(path)
    for what in (
        "1 tendons",
        "dry friction of slide",
        "contacts of 1",
        "the actuator push",
        "drop=",
    ):
        assert what in str(told.value)
    with pytest.raises(ValueError, match="cannot keep 1 tendons;"):
        mechanism_of_file(path, drop=["friction", "contacts", "actuators"])
    with pytest.raises(ValueError, match="drop: colour: there are: actuators"):
        mechanism_of_file(path, drop=["colour"])
    path.write_text("<mujoco><worldbody><bod/></worldbody></mujoco>")
    with pytest.raises(ValueError, match=r"rough\.xml: MuJoCo cannot read it"):
        mechanism_of_file(path)


GATE = """<mujoco model="gate"><compiler angle="radian"/><option gravity="0 0 -9.81"/><worldbody>
  <body name="a"><joint name="j" axis="0 1 0" range="-0.5 1.2" solreflimit="{}" solimplimit="0.9999 0.9999 0.001"/>
    <inertial pos="0 0 -.5" mass="1" diaginertia=".09 .08 .02"/>
    <body name="b" pos="0 0 -1"><joint name="k" axis="0 1 0" damping=".05"/>
      <inertial pos="0 0 -.4" mass=".7" diaginertia=".05 .04 .02"/></body></body></worldbody></mujoco>"""


def ended(m: Any, names: tuple[str, ...], stop: float, step: float) -> tuple[np.ndarray, Any]:
    """Values of observables at the end of a run of order 6, and its ledger, which closes."""
    declaration = m.build()
    assert not check(declaration)
    model = build_model(declaration, default_scheme(declaration, 6))
    found = run(Monolithic(model, NativeInstance(model)), Options(stop=stop, step=step))
    total = found.ledger.summary()
    assert total.closed and abs(total.network.unexplained) <= 1e-11
    return np.array([found.column(n)[-1] for n in names]), total


@pytest.mark.parametrize("damping, restitution", [(1.0, 0.1353), (0.3, 0.451), (2.0, 0.04777)])
def test_a_limit_is_what_that_of_mujoco_becomes_as_its_impact_gets_short(
    tmp_path: Path, damping: float, restitution: float
) -> None:
    """At a time constant of 0.5 ms what lasts in the contact is 1e-2 of 4 rad/s; a restitution off by 0.01 gives 4e-2 rad/s."""
    path, qpos, qvel = tmp_path / "gate.xml", [0.3, 0.2], [4.0, -1.0]
    path.write_text(GATE.format(f"0.02 {damping}"))
    m = mechanism_of_file(path, qpos=qpos, qvel=qvel)
    assert f"limits of j are hard and throw back with a restitution of {restitution}" in m.assumed[0]
    own, total = ended(m, ("j.angle", "k.angle", "j.rate", "k.rate"), 0.4, 2.5e-3)
    assert len(total.events) == 1

    constant = 5e-4
    model = mujoco.MjModel.from_xml_string(GATE.format(f"{constant} {damping}"))
    model.opt.timestep, model.opt.integrator = constant / 50, mujoco.mjtIntegrator.mjINT_RK4
    model.opt.tolerance = 1e-14
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_REFSAFE)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_step(model, data, round(0.4 / model.opt.timestep))
    assert np.abs(np.concatenate([data.qpos, data.qvel]) - own).max() <= 0.02


MIMIC = """<robot name="pair"><link name="base"/>
  <link name="a"><inertial><origin xyz="0 0 .2"/><mass value="3"/>
    <inertia ixx="0.05" iyy="0.05" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="b"><inertial><origin xyz="0 0 .2"/><mass value="3"/>
    <inertia ixx="0.05" iyy="0.05" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="j" type="continuous"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/></joint>
  <joint name="k" type="continuous"><parent link="base"/><child link="b"/><axis xyz="0 1 0"/>
    <mimic joint="j" multiplier="-2" offset="0.1"/></joint>
</robot>"""


def test_equal_joints_are_gears(tmp_path: Path) -> None:
    """Beside 5 J s'' = c (sin s - 2 sin(0.1 - 2 s)), J = 0.05 + 3 0.2^2 kg.m2, c = 3 g 0.2 m."""
    from scipy.integrate import solve_ivp

    path = tmp_path / "pair.urdf"
    path.write_text(MIMIC)
    with pytest.raises(ValueError, match=r"the equality 0 misses by 0\.1 .* give `qpos`"):
        mechanism_of_file(path)
    own, _ = ended(mechanism_of_file(path, qpos=[0.2, -0.3], qvel=[1.0, -2.0]), ("j.angle", "k.angle"), 0.3, 2.5e-3)
    j, c = 0.05 + 3 * 0.04, 3 * 9.81 * 0.2

    def rates(_: float, y: np.ndarray) -> list[float]:
        return [y[1], (c * np.sin(y[0]) - 2 * c * np.sin(0.1 - 2 * y[0])) / (5 * j)]

    exact = solve_ivp(rates, (0, 0.3), [0.2, 1.0], rtol=1e-13, atol=1e-14).y[0, -1]
    assert abs(own[0] - exact) <= 1e-10 and abs(own[1] + 2 * own[0] - 0.1) <= 1e-12


def test_equalities_that_hold_a_joint_or_are_off_or_bend(tmp_path: Path) -> None:
    path = tmp_path / "held.xml"
    equal = '<equality><joint joint1="hip" {}/></equality><actuator>'
    path.write_text(CART.replace("<actuator>", equal.format('polycoef="0 1 0 0 0"')))
    m = mechanism_of_file(path)
    assert [j.kind for j in m.joints] == ["prismatic", "fixed", "revolute"] and "hip is fixed by" in m.assumed[0]
    path.write_text(CART.replace("<actuator>", equal.format('active="false"')))
    assert [j.kind for j in mechanism_of_file(path).joints] == ["prismatic", "revolute", "revolute"]
    path.write_text(CART.replace("<actuator>", equal.format('joint2="knee" polycoef="0 1 2 0 0"')))
    with pytest.raises(ValueError, match="the equality 0, which is a polynomial of the coordinate"):
        mechanism_of_file(path)
