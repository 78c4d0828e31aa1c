"""Systems of particles, rigid bodies and joints: `Multibody` for particles, `Mechanism` for bodies and joints."""

from phfmu.listed_names import list_names

list_names(__name__)
