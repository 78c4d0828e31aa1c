"""The names of `phfmu.components.mechanical` and where they are defined."""

from phfmu.components.mechanical.chain import chain as chain
from phfmu.components.mechanical.clutch import clutch as clutch
from phfmu.components.mechanical.contacts import bumper as bumper
from phfmu.components.mechanical.contacts import end_stop as end_stop
from phfmu.components.mechanical.contacts import impact_pair as impact_pair
from phfmu.components.mechanical.fekete import fekete as fekete
from phfmu.components.mechanical.four_bar import four_bar as four_bar
from phfmu.components.mechanical.four_particle import four_particle as four_particle
from phfmu.components.mechanical.gas_cylinder import gas_cylinder as gas_cylinder
from phfmu.components.mechanical.heavy_top import heavy_top as heavy_top
from phfmu.components.mechanical.mass_spring import mass_spring as mass_spring
from phfmu.components.mechanical.multibody import Mechanism as Mechanism
from phfmu.components.mechanical.multibody import Multibody as Multibody
from phfmu.components.mechanical.net import net as net
from phfmu.components.mechanical.rotational import flexible_shaft as flexible_shaft
from phfmu.components.mechanical.rotational import rotational_inertia as rotational_inertia
from phfmu.components.mechanical.torque_source import torque_source as torque_source
from phfmu.components.mechanical.translational import damper as damper
from phfmu.components.mechanical.translational import mass as mass
from phfmu.components.mechanical.translational import spring as spring

__all__: list[str]
