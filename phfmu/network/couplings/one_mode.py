"""A composed declaration without ideal switches, as `Switching` asks one with them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model
from phfmu.engine.landing import Change
from phfmu.engine.python import PythonInstance
from phfmu.engine.switched import SwitchedInstance


class OneMode:
    """Its instance, which has one mode only; what is asked of instances is of that."""

    mode: tuple[int, ...] = ()
    unsettled = False

    def __init__(self, model: Model):
        self.model, self.present = model, PythonInstance(model)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.present, name)

    def prepare(self, h: float) -> None:
        """No mode has to be found."""

    def change(self, p: NDArray[np.float64], h: float) -> Change:
        """Takes the parameters p."""
        self.present.set_parameters(p)
        self.present.initialise()
        energy, lost = np.zeros((2, self.model.step.ncomp))
        return Change(energy, lost, ())


def instance_of(model: Model) -> SwitchedInstance | OneMode:
    """In Python, with or without ideal switches."""
    return OneMode(model) if model.modes is None else SwitchedInstance(model, PythonInstance)
