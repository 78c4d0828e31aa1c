"""phfmu: port-Hamiltonian DAEs as co-simulation components whose energy balance is exact.

Public names are loaded when they are first used, so that importing the package costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_WHERE = {
    "phfmu.declare.variable": ("Variable", "state", "algebraic", "parameter", "time"),
    "phfmu.declare.port": ("Domain", "Port", "drive", "ELECTRICAL", "TRANSLATIONAL", "ROTATIONAL", "HYDRAULIC"),
    "phfmu.declare.energy": ("Energy", "ClosedPair", "energy", "strain_energy"),
    "phfmu.declare.phdae": (
        "PHDAE", "Block", "Holonomic", "Observable", "block", "skew", "damping", "observable",
    ),
    "phfmu.declare.transformation": ("SystemTransformation", "keeping_E"),
    "phfmu.declare.descriptor": ("reduce_descriptor",),
    "phfmu.declare.parametrised": ("Parametrised",),
    "phfmu.discretise.discrete_pair": ("DiscretePair", "discrete_pair", "inverse_jacobian", "with_closed_pair"),
    "phfmu.declare.check": ("check", "Problem"),
    "phfmu.declare.check_values": ("check_values",),
    "phfmu.discretise.collocated": ("Collocated",),
    "phfmu.discretise.discrete": ("discrete_gradient", "discrete_jacobian"),
    "phfmu.discretise.gradient_pair": ("GradientPair",),
    "phfmu.discretise.dirac_dissipative": ("DiracDissipative",),
    "phfmu.discretise.model": ("Model", "build_model", "default_scheme"),
    "phfmu.discretise.terms": ("DeclarationError",),
    "phfmu.engine.status": ("Status", "StepFailure"),
    "phfmu.engine.python": ("PythonInstance",),
    "phfmu.engine.native": ("NativeInstance",),
    "phfmu.fmu.reader": ("FMUInstance",),
    "phfmu.fmu.export": ("export",),
    "phfmu.network.network": ("Network",),
    "phfmu.network.scene": ("Scene", "Event"),
    "phfmu.network.run": ("run",),
    "phfmu.network.stepper": ("Monolithic", "InconsistentState"),
    "phfmu.network.coupled": ("Coupled",),
    "phfmu.network.members": ("EngineMember",),
    "phfmu.network.fmu_member": ("FMUMember",),
    "phfmu.fmu.manifest": ("PortMap",),
    "phfmu.discretise.rank": ("ConstraintRank", "constraint_rank"),
    "phfmu.discretise.start": ("Projection", "project_start"),
}  # fmt: skip
_OWNER = {name: module for module, names in _WHERE.items() for name in names}
__all__ = tuple(_OWNER)  # pyright: ignore[reportUnsupportedDunderAll]

if TYPE_CHECKING:
    from phfmu.declare.check import Problem as Problem
    from phfmu.declare.check import check as check
    from phfmu.declare.check_values import check_values as check_values
    from phfmu.declare.descriptor import reduce_descriptor as reduce_descriptor
    from phfmu.declare.energy import (
        ClosedPair as ClosedPair,
    )
    from phfmu.declare.energy import (
        Energy as Energy,
    )
    from phfmu.declare.energy import (
        energy as energy,
    )
    from phfmu.declare.energy import (
        strain_energy as strain_energy,
    )
    from phfmu.declare.parametrised import Parametrised as Parametrised
    from phfmu.declare.phdae import (
        PHDAE as PHDAE,
    )
    from phfmu.declare.phdae import (
        Block as Block,
    )
    from phfmu.declare.phdae import (
        Holonomic as Holonomic,
    )
    from phfmu.declare.phdae import (
        Observable as Observable,
    )
    from phfmu.declare.phdae import (
        block as block,
    )
    from phfmu.declare.phdae import (
        damping as damping,
    )
    from phfmu.declare.phdae import (
        observable as observable,
    )
    from phfmu.declare.phdae import (
        skew as skew,
    )
    from phfmu.declare.port import (
        ELECTRICAL as ELECTRICAL,
    )
    from phfmu.declare.port import (
        HYDRAULIC as HYDRAULIC,
    )
    from phfmu.declare.port import (
        ROTATIONAL as ROTATIONAL,
    )
    from phfmu.declare.port import (
        TRANSLATIONAL as TRANSLATIONAL,
    )
    from phfmu.declare.port import (
        Domain as Domain,
    )
    from phfmu.declare.port import (
        Port as Port,
    )
    from phfmu.declare.port import (
        drive as drive,
    )
    from phfmu.declare.transformation import (
        SystemTransformation as SystemTransformation,
    )
    from phfmu.declare.transformation import (
        keeping_E as keeping_E,
    )
    from phfmu.declare.variable import (
        Variable as Variable,
    )
    from phfmu.declare.variable import (
        algebraic as algebraic,
    )
    from phfmu.declare.variable import (
        parameter as parameter,
    )
    from phfmu.declare.variable import (
        state as state,
    )
    from phfmu.declare.variable import (
        time as time,
    )
    from phfmu.discretise.collocated import Collocated as Collocated
    from phfmu.discretise.dirac_dissipative import DiracDissipative as DiracDissipative
    from phfmu.discretise.discrete import discrete_gradient as discrete_gradient
    from phfmu.discretise.discrete import discrete_jacobian as discrete_jacobian
    from phfmu.discretise.discrete_pair import DiscretePair as DiscretePair
    from phfmu.discretise.discrete_pair import discrete_pair as discrete_pair
    from phfmu.discretise.discrete_pair import inverse_jacobian as inverse_jacobian
    from phfmu.discretise.discrete_pair import with_closed_pair as with_closed_pair
    from phfmu.discretise.gradient_pair import GradientPair as GradientPair
    from phfmu.discretise.model import Model as Model
    from phfmu.discretise.model import build_model as build_model
    from phfmu.discretise.model import default_scheme as default_scheme
    from phfmu.discretise.rank import ConstraintRank as ConstraintRank
    from phfmu.discretise.rank import constraint_rank as constraint_rank
    from phfmu.discretise.start import Projection as Projection
    from phfmu.discretise.start import project_start as project_start
    from phfmu.discretise.terms import DeclarationError as DeclarationError
    from phfmu.engine.native import NativeInstance as NativeInstance
    from phfmu.engine.python import PythonInstance as PythonInstance
    from phfmu.engine.status import Status as Status
    from phfmu.engine.status import StepFailure as StepFailure
    from phfmu.fmu.export import export as export
    from phfmu.fmu.manifest import PortMap as PortMap
    from phfmu.fmu.reader import FMUInstance as FMUInstance
    from phfmu.network.coupled import Coupled as Coupled
    from phfmu.network.fmu_member import FMUMember as FMUMember
    from phfmu.network.members import EngineMember as EngineMember
    from phfmu.network.network import Network as Network
    from phfmu.network.run import run as run
    from phfmu.network.scene import Event as Event
    from phfmu.network.scene import Scene as Scene
    from phfmu.network.stepper import InconsistentState as InconsistentState
    from phfmu.network.stepper import Monolithic as Monolithic


def __getattr__(name: str) -> Any:
    if name not in _OWNER:
        raise AttributeError(f"module 'phfmu' has no attribute '{name}'")
    from importlib import import_module

    return getattr(import_module(_OWNER[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_OWNER])
