"""The names of `phfmu.components.mechanical.multibody` and where they are defined."""

from phfmu.components.mechanical.multibody.builder import Multibody as Multibody
from phfmu.components.mechanical.multibody.contact import Compliance as Compliance
from phfmu.components.mechanical.multibody.contact import Limits as Limits
from phfmu.components.mechanical.multibody.from_file import mechanism_of_file as mechanism_of_file
from phfmu.components.mechanical.multibody.mechanism import Mechanism as Mechanism
from phfmu.components.mechanical.multibody.parts import Particle as Particle
from phfmu.components.mechanical.multibody.parts import Point as Point

__all__: list[str]
