"""Systems of particles, rigid bodies and joints: `Multibody` for particles, `Mechanism` for bodies and joints."""

from phfmu.components.mechanical.multibody.builder import Multibody
from phfmu.components.mechanical.multibody.contact import Compliance, Limits
from phfmu.components.mechanical.multibody.from_file import mechanism_of_file
from phfmu.components.mechanical.multibody.mechanism import Mechanism
from phfmu.components.mechanical.multibody.parts import Particle, Point

__all__ = ["Compliance", "Limits", "Mechanism", "Multibody", "Particle", "Point", "mechanism_of_file"]
