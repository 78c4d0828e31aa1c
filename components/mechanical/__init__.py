"""Mechanical components: particles, springs, dampers, inertias and shafts, contacts, and builders of
systems of particles and of mechanisms."""

from phfmu.components.mechanical.chain import chain
from phfmu.components.mechanical.clutch import clutch
from phfmu.components.mechanical.contacts import bumper, end_stop, impact_pair
from phfmu.components.mechanical.fekete import fekete
from phfmu.components.mechanical.four_bar import four_bar
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.mechanical.gas_cylinder import gas_cylinder
from phfmu.components.mechanical.heavy_top import heavy_top
from phfmu.components.mechanical.mass_spring import mass_spring
from phfmu.components.mechanical.multibody import Mechanism, Multibody
from phfmu.components.mechanical.net import net
from phfmu.components.mechanical.rotational import flexible_shaft, rotational_inertia
from phfmu.components.mechanical.torque_source import torque_source
from phfmu.components.mechanical.translational import damper, mass, spring

__all__ = [
    "Mechanism",
    "Multibody",
    "bumper",
    "chain",
    "clutch",
    "damper",
    "end_stop",
    "fekete",
    "flexible_shaft",
    "four_bar",
    "four_particle",
    "gas_cylinder",
    "heavy_top",
    "impact_pair",
    "mass",
    "mass_spring",
    "net",
    "rotational_inertia",
    "spring",
    "torque_source",
]
