"""Bushings beside oscillators in closed form and Euler's equations in quaternions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from phfmu import (
    FMUInstance,
    Monolithic,
    NativeInstance,
    Options,
    PythonInstance,
    build_model,
    check,
    default_scheme,
    export,
    run,
)
from phfmu.components.mechanical.multibody import Mechanism
from tests.wide import longer, wide

MASS, J = 2.0, np.array((0.3, 0.2, 0.15))
K: Any = np.array((30.0, 50.0, 80.0, 3.0, 5.0, 8.0))
D: Any = np.array((0.3, 0.2, 0.1, 0.05, 0.02, 0.03))
C: Any = np.array((10.0, 20.0, 5.0, 1.0, 2.0, 0.5))
OFF: Any = np.array((0.1, -0.2, 0.05))
TURN = Rotation.from_rotvec((0.6, -0.4, 0.3)).as_matrix()
SPIN, SPEED, PLACE = (0.5, 1.0, -0.7), (0.3, -0.2, 0.5), (0.1, 0.0, 0.05)
FRAME: dict[str, Any] = {"axis": (0, 0, 1), "x_axis": (1, 0, 0)}


def ran(declaration: Any, order: int, step: float, stop: float, engine: Any = NativeInstance) -> Any:
    model = build_model(declaration, default_scheme(declaration, order))
    found = run(Monolithic(model, engine(model)), Options(stop=stop, step=step))
    return found


def at(result: Any, name: str, n: int = 3, row: Any = -1) -> np.ndarray:
    return np.array([result.column(f"{name}[{i + 1}]")[row] for i in range(n)])


def block(**more: Any) -> Mechanism:
    """A body far from where its bushing on the ground, off its centre of mass, is not loaded."""
    m = Mechanism("mount")
    b = m.body("block", MASS, J, rotation=TURN, angular_velocity=SPIN, velocity=SPEED, position=PLACE)
    m.bushing("mount", None, b, stiffness=K, damping=D, hardening=C, at_b=OFF, **FRAME, **more)
    return m


def in_quaternions(stop: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rotation, angular velocity in the world, place and velocity of the block by Euler's equations."""

    def slope(_: float, x: np.ndarray) -> np.ndarray:
        e, e0, w, p, v = x[:3], x[3], x[4:7], x[7:10], x[10:]
        turn = Rotation.from_quat(x[:4]).as_matrix()
        angle = 2 * np.arcsin(e)
        g = (K[3:] * angle + C[3:] * angle**3) * 2 / np.sqrt(1 - e**2)  # dV/de
        s, rate = p + turn @ OFF, v + turn @ np.cross(w, OFF)
        force = -(K[:3] * s + C[:3] * s**3 + D[:3] * rate)
        torque = -0.5 * (e0 * g + np.cross(g, e)) + np.cross(OFF, turn.T @ force) - turn.T @ (D[3:] * (turn @ w))
        spun = (torque - np.cross(w, J * w)) / J
        turned = 0.5 * np.append(e0 * w + np.cross(e, w), -e @ w)
        return np.concatenate([turned, spun, v, force / MASS - (0, 0, 9.81)])

    start = np.concatenate([Rotation.from_matrix(TURN).as_quat(), TURN.T @ SPIN, PLACE, SPEED])
    end = solve_ivp(slope, (0, stop), start, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    turn = Rotation.from_quat(end[:4]).as_matrix()
    return turn, turn @ end[4:7], end[7:10], end[10:]


def missed(found: Any, stop: float) -> float:
    turn, spin, place, _ = in_quaternions(stop)
    gaps = at(found, "block.rotation", 9).reshape(3, 3).T - turn, at(found, "block.angular_velocity") - spin
    return max(float(np.abs(g).max()) for g in (*gaps, at(found, "block.position") - place))


@pytest.mark.parametrize("order, step, most", [(2, 2e-3, 1e-3), (6, 2e-2, 1e-6)])
@pytest.mark.parametrize("engine", wide([NativeInstance, PythonInstance], NativeInstance))
def test_large_rotations_are_those_of_eulers_equations(engine: Any, order: int, step: float, most: float) -> None:
    """Up to 59 degrees, where the torque is that of the angle to 1e-9."""
    declaration = block().build()
    assert not check(declaration)
    coarse, fine = (ran(declaration, order, h, 0.6, engine) for h in (step, step / 2))
    errors = missed(coarse, 0.6), missed(fine, 0.6)
    assert errors[0] <= most and order - 0.3 < np.log2(errors[0] / errors[1]) < order + 0.5
    assert abs(fine.ledger.summary().network.unexplained) <= 1e-12


def test_small_motion_is_six_oscillators() -> None:
    """Frequencies sqrt(k/m) and sqrt(K/J); what is left is of the square of the amplitude, and the rounding of angles."""
    small = 1e-6
    start = np.array((1.0, -2.0, 1.5, 0.5, 1.0, -1.0)) * small
    m = Mechanism("mount", gravity=(0, 0, 0))
    b = m.body("block", MASS, J, position=start[:3].tolist(), rotation=Rotation.from_rotvec(start[3:]).as_matrix())
    m.bushing("mount", None, b, stiffness=K, **FRAME)
    found = ran(m.build(), 6, 0.05, 5.0)
    rate = np.sqrt(K / np.array((MASS, MASS, MASS, *J)))
    times = found.time
    motion = np.array([found.column(f"mount.{what}[{i}]") for what in ("displacement", "rotation") for i in (1, 2, 3)])
    assert np.abs(motion - start[:, None] * np.cos(np.outer(rate, times))).max() <= 10 * small**2
    # coordinates of 1 m round by 1e-16, a part 1e-10 of this motion, in each of 100 steps
    assert np.ptp(found.column("energy.stored")) <= 1e-8 * found.column("mount.energy")[0]


@pytest.mark.slow
def test_forces_and_torques_are_the_slopes_of_the_energy() -> None:
    """Rates of momentum and of spin, of bodies with two moving sides; sums of both sides cancel."""
    m = Mechanism("pair", gravity=(0, 0, 0))
    one = m.body("one", 1.0, (0.1, 0.2, 0.25), velocity=(0.1, 0.2, 0), angular_velocity=(0.5, 0, 1))
    other = m.body("other", MASS, J, rotation=TURN, angular_velocity=SPIN, velocity=SPEED, position=PLACE)
    m.bushing("mount", one, other, stiffness=K, damping=D, hardening=C, neutral=(0.05, 0, 0, 0, 0.3, 0), **FRAME)
    h = 1e-3
    found = ran(m.build(), 2, h, 0.5)
    momentum = at(found, "other.momentum", row=slice(None))
    push = at(found, "mount.force", row=250)
    assert (momentum[:, 251] - momentum[:, 249]) / (2 * h) == pytest.approx(push, abs=1e-3)
    spins = []
    for row in range(501):
        whole = np.zeros(3)
        for name, moments in (("one", (0.1, 0.2, 0.25)), ("other", J)):
            turn = at(found, f"{name}.rotation", 9, row).reshape(3, 3).T
            own = turn @ np.diag(moments) @ turn.T @ at(found, f"{name}.angular_velocity", row=row)
            whole += own + np.cross(at(found, f"{name}.position", row=row), at(found, f"{name}.momentum", row=row))
            if name == "other":
                spins.append(own)
        if row == 0:
            start = whole
    assert whole == pytest.approx(start, abs=1e-12)  # no momentum from nowhere
    assert at(found, "one.momentum") + momentum[:, -1] == pytest.approx((0.1 + 0.6, 0.2 - 0.4, 1.0), abs=1e-12)
    assert (spins[251] - spins[249]) / (2 * h) == pytest.approx(at(found, "mount.torque", row=250), abs=1e-3)
    energy = found.column("mount.energy")
    assert np.all(energy >= 0) and energy[0] > 0


@pytest.mark.parametrize("order", [2, 6])
def test_a_stiff_bushing_is_a_joint_at_coarse_steps(order: int) -> None:
    """1e8 N/m hold the pin of a pendulum at steps of many of its periods; the load stretches it by about m g/k."""

    def pendulum(pin: str) -> Mechanism:
        m = Mechanism("pendulum", planar=True)
        b = m.rod("rod", 1.0, 1.0, position=(0.5, 0.0))
        if pin == "bushing":
            m.bushing("pin", None, b, at_b=(-0.5, 0), stiffness=(1e8, 1e8, 0), damping=(1e4, 1e4, 0))
        else:
            m.joint("revolute", "pin", None, b, at_b=(-0.5, 0))
        return m

    soft, hard = (ran(pendulum(pin).build(), order, 0.01, 2.0) for pin in ("bushing", "joint"))
    assert np.abs(soft.column("rod.angle") - hard.column("rod.angle")).max() <= 1e-4
    assert np.abs(at(soft, "pin.displacement", 2, slice(None))).max() <= 1e-6
    assert abs(soft.ledger.summary().network.unexplained) <= 1e-10


def test_a_plane_bushing_turns_like_a_spring_on_a_hinge() -> None:
    """Up to a right angle its torque is K times the angle to 2e-6, as of a joint with a stiffness."""

    def wheel(**bushing: Any) -> Any:
        m = Mechanism("wheel", planar=True)
        b = m.body("wheel", 1.0, 0.2, angular_velocity=5.0)
        m.joint("revolute", "axle", None, b, stiffness=0.0 if bushing else 2.0, neutral=0.0 if bushing else 0.3)
        if bushing:
            m.bushing("mount", None, b, **bushing)
        return ran(m.build(), 6, 0.01, 1.0)

    by_bushing = wheel(stiffness=(0, 0, 2.0), neutral=(0, 0, 0.3))
    assert 1.5 < by_bushing.column("mount.rotation").max() < 1.65
    assert by_bushing.column("wheel.angle") == pytest.approx(wheel().column("wheel.angle"), abs=2e-6)


@pytest.mark.parametrize(
    ("version", "order"), longer([(v, k) for v in ("2.0", "3.0") for k in (2, 6)], ("2.0", 6), ("3.0", 2))
)
def test_a_unit_has_the_bits_of_the_engine(version: str, order: int, tmp_path: Path, compiler: None) -> None:
    declaration = block().build()
    model = build_model(declaration, default_scheme(declaration, order))
    (path,) = export(model, tmp_path, (version,), step=0.01)
    unit, native, python = FMUInstance(path), NativeInstance(model), PythonInstance(model)
    for i in range(50):
        for one in (unit, native, python):
            one.do_step(0.01 * i, 0.01)
        assert np.array_equal(unit.output(), native.output())
        assert unit.ledger()["dissipated"] == native.ledger()["dissipated"] != 0.0
    assert np.abs(python.x - native.x).max() <= 1e-12


@pytest.mark.parametrize(
    "given, message",
    [
        ({"stiffness": (1, 2, 3)}, "stiffness of bushing 'mount' needs 6 finite numbers"),
        ({"stiffness": (1, 1, 1, 1, 1, -2)}, "stiffness .* must not be negative"),
        ({"stiffness": (0,) * 6}, "neither stiffness nor damping"),
        ({"stiffness": (1,) * 6, "b": "rod"}, "body 'thin' is a rod, without directions"),
        ({"stiffness": (1,) * 6, "b": None}, "between two bodies of m, or the ground and one"),
    ],
)
def test_bad_bushings_are_refused(given: dict[str, Any], message: str) -> None:
    m = Mechanism("m")
    bodies = {"block": m.body("block", 1.0, (1, 1, 1)), "rod": m.rod("thin", 1.0, 1.0), None: None}
    with pytest.raises(ValueError, match=message):
        m.bushing("mount", None, bodies[given.pop("b", "block")], **given)


def test_a_body_turns_through_half_a_turn_and_further() -> None:
    """There is no singularity: the energy is kept over some turns."""
    m = Mechanism("wheel")
    b = m.body("wheel", 1.0, J, angular_velocity=(0.5, 20.0, 0.3))
    m.bushing("mount", None, b, stiffness=(1e3, 1e3, 1e3, 5.0, 2.0, 3.0), **FRAME)
    for order in (2, 6):
        found = ran(m.build(), order, 0.02, 2.0)
        assert found.ledger.summary().closed
        assert np.ptp(found.column("energy.stored")) <= 1e-11
        assert (np.diff(np.sign(found.column("mount.rotation[2]"))) < 0).sum() >= 4
