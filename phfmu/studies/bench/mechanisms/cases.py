"""The mechanisms that are compared, with the settings of all methods."""

from __future__ import annotations

from collections.abc import Callable

from phfmu.declare.phdae import PHDAE
from phfmu.studies.bench.mechanisms import described
from phfmu.studies.bench.mechanisms.case import MechanismCase, StepSettings


def chain_declared() -> PHDAE:
    """Four boxes on balls and hinges in turn, from the library's parts."""
    from phfmu.components.mechanical.multibody import Mechanism

    m, last = Mechanism("chain_of_boxes"), None
    for i in range(4):
        mass, spin = 1.0 + 0.1 * i, (1.0, 0.0, 2.0)
        moments = tuple(mass / 12 * (a * a + b * b) for a, b in ((0.1, 0.2), (1.0, 0.2), (1.0, 0.1)))
        velocity = (0.0, 2.0 * (i + 0.5), 0.0)
        box = m.body(
            f"box{i + 1}", mass, moments, position=(i + 0.5, 0.0, 0.0), velocity=velocity, angular_velocity=spin
        )
        kind = ("spherical", "revolute")[i % 2]
        m.joint(kind, f"joint{i + 1}", last, box, at=(float(i), 0.0, 0.0), axis=(0.0, 1.0, 0.0))
        last = box
    return m.build()


def library(name: str) -> Callable[[], PHDAE]:
    def declared() -> PHDAE:
        from phfmu.components.library import build

        return build(name)

    return declared


def positions(*names: str) -> tuple[str, ...]:
    return tuple(f"{name}.position" for name in names)


def chain() -> MechanismCase:
    """Four boxes in space on balls and hinges, spinning; 1 s."""
    steps = StepSettings(
        {2: (0.01, 0.005, 0.002), 6: (0.05, 0.025, 0.0125, 0.01, 0.00625)},
        mujoco=(0.01, 0.005, 0.002, 0.001, 0.0005), exudyn=(0.002, 0.001, 0.0005), exudyn_tree=(0.02, 0.01, 0.005),
        tolerances=(1e-4, 1e-7, 1e-10),
    )  # fmt: skip
    boxes = positions(*(f"box{i + 1}" for i in range(4)))
    return MechanismCase("chain of 4", chain_declared, boxes, 1.0, steps, described.chain())


def slider_crank() -> MechanismCase:
    """Crank, rod and piston; 1 s."""
    steps = StepSettings(
        {2: (0.005, 0.002, 0.001), 6: (0.02, 0.01, 0.005, 0.0025)},
        mujoco=(0.002, 0.001, 0.0005), exudyn=(0.002, 0.001, 0.0005),
    )  # fmt: skip
    bodies = positions("crank", "rod", "piston")
    return MechanismCase("slider-crank", library("slider_crank"), bodies, 1.0, steps, described.slider_crank())


def bricard() -> MechanismCase:
    """Bricard's linkage, one row too many; 2 s."""
    steps = StepSettings(
        {2: (0.01, 0.005, 0.002), 6: (0.1, 0.05, 0.025, 0.0125)},
        mujoco=(0.002, 0.001, 0.0005), exudyn=(0.002, 0.001, 0.0005), opensim=(1e-5, 1e-7, 1e-9),
    )  # fmt: skip
    points = tuple(f"P{i + 1}" for i in range(4))
    return MechanismCase("bricard", library("bricard"), points, 2.0, steps, described.bricard())


def andrews() -> MechanismCase:
    """Andrews' squeezer; 0.03 s, for which its solution is published."""
    steps = StepSettings(
        {2: (1e-4, 5e-5, 2e-5), 6: (3e-4, 2e-4, 1e-4, 5e-5)},
        mujoco=(2e-5, 1e-5, 5e-6), exudyn=(5e-5, 2e-5, 1e-5), ida=(1e-4, 1e-6, 1e-8, 1e-10),
        opensim=(1e-5, 1e-7, 1e-9),
    )  # fmt: skip
    bodies = positions("crank", "rod", "rocker", "arm5", "link4", "arm7", "link6")
    return MechanismCase("andrews", library("andrews"), bodies, 0.03, steps, described.andrews())


def car_axis() -> MechanismCase:
    """The car axis over its road; 3 s, for which its solution is published; lengths without unit."""
    steps = StepSettings({2: (5e-3, 2e-3, 1e-3), 6: (2e-2, 1e-2, 5e-3, 2.5e-3)}, ida=(1e-4, 1e-6, 1e-8, 1e-10))
    return MechanismCase("car axis", library("car_axis"), ("left", "right"), 3.0, steps, lagrange=described.car_axis())


def ur5() -> MechanismCase:
    """The arm UR5 falls from rest; 1 s."""
    steps = StepSettings(
        {2: (0.005, 0.002, 0.001), 6: (0.02, 0.01, 0.005, 0.0025)},
        mujoco=(0.01, 0.005, 0.002, 0.001, 0.0005), exudyn=(0.002, 0.001, 0.0005), exudyn_tree=(0.01, 0.005, 0.002),
        tolerances=(1e-4, 1e-7, 1e-10),
    )  # fmt: skip
    return MechanismCase("ur5", library("ur5"), ("forearm_link.position", "flange"), 1.0, steps, described.ur5())


def pendulum() -> MechanismCase:
    """A point mass on a bar; 10 s."""
    steps = StepSettings({2: (0.02, 0.005, 0.002), 6: (0.1, 0.05, 0.025, 0.0125)}, opensim=(1e-5, 1e-7, 1e-9))
    return MechanismCase("pendulum", library("pendulum"), ("P",), 10.0, steps, described.pendulum())


def four_bar() -> MechanismCase:
    """Two four-bar windows through their flat positions; 5 s."""
    steps = StepSettings({2: (0.01, 0.005, 0.002), 6: (0.05, 0.025, 0.0125)}, opensim=(1e-5, 1e-7, 1e-9))
    return MechanismCase(
        "four-bar", library("four_bar"), ("B0",), 5.0, steps, described.four_bar(), described.parallel_cranks()
    )


CASES: dict[str, Callable[[], MechanismCase]] = {
    "chain of 4": chain,
    "slider-crank": slider_crank,
    "bricard": bricard,
    "andrews": andrews,
    "car axis": car_axis,
    "ur5": ur5,
}
#: the library of multibody problems of the IFToMM
IFTOMM: dict[str, Callable[[], MechanismCase]] = {
    "A01 pendulum": pendulum,
    "A02 four-bar": four_bar,
    "A03 andrews": andrews,
    "A04 bricard": bricard,
}
