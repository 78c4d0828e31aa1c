"""Models of the library and of declarations in other forms, by name."""

from __future__ import annotations

from functools import cache

import numpy as np

from phfmu import Collocated, Scene, StepFailure, TwoLevel, build_model
from phfmu.components.electrical import fault_resistor, rlc_load, synchronous_machine
from phfmu.components.library import build
from phfmu.components.mechanical.translational import mass, spring

ERRORS = (ValueError, StepFailure)
#: components with terms that the default arguments leave out
FORMS = {
    "mass_spring_damper": lambda: mass(2.0, k=5.0, d=0.3),
    "spring_damper": lambda: spring(3.0, d=0.2),
    "closed_fault": lambda: fault_resistor(20.0),
    "rl_load": lambda: rlc_load(2.0, 0.01),
    "machine_abc_flux": lambda: synchronous_machine(coordinates="abc-flux"),
    "machine_current": lambda: synchronous_machine(coordinates="current"),
}


@cache
def declaration(name):
    made = FORMS[name]() if name in FORMS else build(name)
    return made.declaration() if isinstance(made, Scene) else made


@cache
def plan(name, k):
    d = declaration(name)
    return build_model(d, (TwoLevel if d.constraints else Collocated)(k))


def start(instance):
    """A state away from zero: moved by 10 to 30 % of its size, unless hidden constraints tie it, or its limits would."""
    model = instance.model
    instance.reset()
    if not model.checks and model.name not in ("hygov", "gast"):
        size = np.maximum(np.abs(model.x0), [v for s in model.declaration.states for v in s.nominal])
        instance.set_x(model.t0, model.x0 + size * np.random.default_rng(5).uniform(0.1, 0.3, len(size)))
        instance.initialise()
    return instance
