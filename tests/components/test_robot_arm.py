"""The robot arm beside MuJoCo's, in joint angles by RK4 with short steps; its table beside the file; the work of its motors."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from phfmu import Monolithic, NativeInstance, Options, PythonInstance, build_model, default_scheme, open_result, run
from phfmu.cli import main
from phfmu.components.mechanical.mechanisms.ur5 import FLANGE, JOINTS, LINKS, ur5
from phfmu.components.scenes.mechanical.robot_arm import robot_arm
from tests.wide import longer, wide

NAMES = [name for name, *_ in JOINTS]
POSE, SPEEDS = (0.3, -1.2, 1.0, -0.8, -1.2, 0.4), (1.0, -0.5, 1.5, 2.0, -1.0, 3.0)
TORQUES, DAMPING, STOP = (5.0, -20.0, -8.0, 2.0, 1.0, -0.5), 0.3, 0.3


def falling(damping: float = DAMPING) -> Any:
    """All joints in motion, all motors with a torque."""
    starts = dict(zip((f"{n}.torque" for n in NAMES), TORQUES, strict=True))
    return ur5(POSE, speeds=SPEEDS, damping=damping).with_starts(starts)


def mjcf() -> str:
    """The table as a model of MuJoCo."""
    text = "<site name='flange' pos='{} {} {}'/>".format(*FLANGE)
    for (link, mass, z, moments), (joint, at, pitch, axis) in reversed(list(zip(LINKS, JOINTS, strict=True))):
        place, along, inertia = (" ".join(f"{x!r}" for x in v) for v in (at, axis, moments))
        quat = f"{float(np.cos(pitch / 2))!r} 0 {float(np.sin(pitch / 2))!r} 0"
        text = (
            f"<body name='{link}' pos='{place}' quat='{quat}'><joint name='{joint}' type='hinge' axis='{along}' "
            f"damping='{DAMPING}'/><inertial pos='0 0 {z}' mass='{mass}' diaginertia='{inertia}'/>{text}</body>"
        )
    option = "<option gravity='0 0 -9.81' integrator='RK4'><flag contact='disable'/></option>"
    return f"<mujoco>{option}<worldbody>{text}</worldbody></mujoco>"


@cache
def peer(steps: int = 12000) -> dict[str, np.ndarray]:
    """Angles, rates and the flange after STOP, and the angle that each joint turned by."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(mjcf())
    model.opt.timestep = STOP / steps
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = POSE, SPEEDS, TORQUES
    mujoco.mj_step(model, data, steps)
    mujoco.mj_forward(model, data)
    return {
        "angle": data.qpos.copy(), "rate": data.qvel.copy(), "flange": data.site("flange").xpos.copy(),
        "turned": data.qpos - np.array(POSE),
    }  # fmt: skip


def simulated(declaration: Any, order: int, step: float, engine: Any = NativeInstance, stop: float = STOP) -> Any:
    model = build_model(declaration, default_scheme(declaration, order))
    return run(Monolithic(model, engine(model)), Options(stop=stop, step=step))


def errors(r: Any) -> np.ndarray:
    """Of angles [rad], rates [rad/s] and the flange [m] at the end."""
    found = {what: np.array([r.column(f"{n}.{what}")[-1] for n in NAMES]) for what in ("angle", "rate")}
    found["flange"] = np.array([r.column(f"flange[{i}]")[-1] for i in (1, 2, 3)])
    off = {what: value - peer()[what] for what, value in found.items()}
    off["angle"] = np.angle(np.exp(1j * off["angle"]))
    return np.array([np.abs(off[what]).max() for what in ("angle", "rate", "flange")])


def test_falls_as_in_mujoco() -> None:
    found = errors(simulated(falling(), 6, 2.5e-3))
    rounding = max(np.abs(peer()[what] - peer(6000)[what]).max() for what in ("angle", "flange"))
    assert rounding < 5e-11  # RK4 at twice the step: the peer itself
    assert found[0] < 1e-10 and found[2] < 1e-10 and found[1] < 1e-9


@pytest.mark.parametrize(("order", "step"), [(2, 1e-3), (6, 2e-2)])
@pytest.mark.parametrize("engine", wide([NativeInstance, PythonInstance], NativeInstance))
def test_angles_rates_and_flange_have_the_order_of_the_scheme(order: int, step: float, engine: Any) -> None:
    coarse, fine = (errors(simulated(falling(), order, h, engine)) for h in (step, step / 2))
    assert np.all(np.abs(np.log2(coarse / fine) - order) < 0.4), (coarse, fine)


def booked(r: Any) -> np.ndarray:
    """What each motor supplied [J], in the order of the joints."""
    supplied = {p.port: p.supplied for p in r.ledger.summary().ports}
    return np.array([supplied[n] for n in NAMES])


@pytest.mark.parametrize(("order", "step", "most"), [(2, 5e-4, 1e-3), (6, 2.5e-3, 1e-9)])
@pytest.mark.parametrize("engine", wide([NativeInstance, PythonInstance], NativeInstance))
def test_each_motor_books_its_torque_times_the_angle(order: int, step: float, most: float, engine: Any) -> None:
    r = simulated(falling(), order, step, engine)
    assert booked(r) == pytest.approx(np.array(TORQUES) * peer()["turned"], abs=most)
    total = r.ledger.summary().network
    assert total.dissipated > 0.1
    assert abs(total.unexplained) < 1e-12 * np.abs(booked(r)).sum()


@pytest.mark.parametrize(("version", "order"), [(3, 6), *longer([(2, 2), (2, 6), (3, 2)], (2, 2))])
@pytest.mark.usefixtures("compiler")
def test_units_book_the_same_works(version: int, order: int, tmp_path: Path) -> None:
    """Bit for bit the native run."""
    given = [f"--set={n}.torque={t}" for n, t in zip(NAMES, TORQUES, strict=True)]
    pose = f"ur5(pose={POSE}, speeds={SPEEDS}, damping={DAMPING})"
    assert (
        main(["export", pose, "--step", "2.5e-3", "--order", str(order), "--fmi", str(version), "-o", str(tmp_path)])
        == 0
    )
    unit, file = next(tmp_path.glob("*.fmu")), str(tmp_path / "unit.csv")
    assert main(["run", str(unit), *given, "--stop", str(STOP), "--step", "2.5e-3", "--quiet", "-o", file]) == 0
    own, found = simulated(falling(), order, 2.5e-3), open_result(file)
    works = np.array([found.column(f"{n}.energy")[-1] for n in NAMES])
    assert works == pytest.approx(booked(own), rel=1e-12, abs=1e-12)
    for n in NAMES:
        assert np.array_equal(found.column(f"{n}.rate"), own.column(f"{n}.rate"))


def test_what_is_lost_goes_into_friction_alone() -> None:
    """Without torques and friction the energy stays; carried, the arm stays in its pose."""
    still = simulated(ur5(POSE, speeds=SPEEDS), 6, 2.5e-3).ledger.summary().network
    assert abs(still.stored) < 1e-12 and not still.dissipated
    r = simulated(ur5(carried=True), 2, 2e-3, stop=0.2)
    assert max(np.ptp(r.column(f"{n}.angle")) for n in NAMES) < 1e-10


@pytest.mark.parametrize("order", wide([2, 6], 6))
def test_the_scene_ten_times_as_long(order: int) -> None:
    scene = robot_arm()
    model = build_model(scene.declaration(), default_scheme(scene.declaration(), order))
    r = run(Monolithic(model, NativeInstance(model)), Options(stop=10.0, step=scene.step, events=scene.events))
    s: Any = r.ledger.summary()
    assert s.closed and abs(s.network.unexplained) < 1e-12 * (np.abs(booked(r)).sum() + s.network.dissipated)


def test_a_pose_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match=r"ur5: pose needs 6 finite numbers, got \[0.1, 0.2\]"):
        ur5((0.1, 0.2))


def test_the_table_is_that_of_the_file() -> None:
    where = "cmeel.prefix/share/example-robot-data/robots/ur_description/urdf/ur5_robot.urdf"
    found = [file for folder in sys.path if (file := Path(folder) / where).is_file()]
    if not found:
        pytest.skip("ur5_robot.urdf of example-robot-data is missing")
    robot = ElementTree.parse(found[0]).getroot()

    def numbers(element: Any, *names: str) -> list[float]:
        return [float(x) for name in names for x in element.get(name).split()]

    for (link, mass, z, moments), (joint, at, pitch, axis) in zip(LINKS, JOINTS, strict=True):
        inertial: Any = robot.find(f"link[@name='{link}']/inertial")
        hinge: Any = robot.find(f"joint[@name='{joint}_joint']")
        assert hinge.find("child").get("link") == link
        assert numbers(inertial.find("mass"), "value") == [mass]
        assert numbers(inertial.find("origin"), "xyz", "rpy") == [0, 0, z, 0, 0, 0]
        assert numbers(inertial.find("inertia"), "ixx", "iyy", "izz", "ixy", "ixz", "iyz") == [*moments, 0, 0, 0]
        assert numbers(hinge.find("origin"), "xyz", "rpy") == pytest.approx([*at, 0, pitch, 0], abs=1e-11)
        assert numbers(hinge.find("axis"), "xyz") == list(axis)
    assert numbers(robot.find("joint[@name='ee_fixed_joint']/origin"), "xyz") == list(FLANGE)
