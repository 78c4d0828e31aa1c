"""Gears, belts and racks: fixed ratios between the rates of two joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phfmu.components.mechanical.multibody.joint import KinematicJoint, rate


@dataclass(frozen=True, eq=False)
class Gear:
    """rate of b = ratio times rate of a; ratio [1, m/rad or rad/m], as the joints turn or slide."""

    name: str
    a: KinematicJoint
    b: KinematicJoint
    ratio: float

    def __post_init__(self) -> None:
        for joint in (self.a, self.b):
            if len(joint.equations.coordinates) != 1:
                raise ValueError(
                    f"gear '{self.name}': joint '{joint.name}' is {joint.kind}, with "
                    f"{len(joint.equations.coordinates)} coordinates; gears are between joints with one each"
                )
        if self.a is self.b or not np.isfinite(self.ratio) or not self.ratio:
            raise ValueError(
                f"gear '{self.name}': it is between two joints, with a ratio that is finite and not zero, got {self.ratio:g} of "
                f"'{self.a.name}' and '{self.b.name}'"
            )

    @property
    def unit(self) -> str:
        """The unit of the ratio."""
        a, b = (joint.equations.coordinates[0].unit for joint in (self.a, self.b))
        return "1" if a == b else f"{b}/{a}"

    def start(self) -> float:
        """s_b - ratio s_a at the start."""
        return self.b.begins(0) - self.ratio * self.a.begins(0)

    def slip(self) -> float:
        """By how much the rates at the start miss the ratio."""
        return rate(self.b) - self.ratio * rate(self.a)
