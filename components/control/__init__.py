"""Controllers: signals in, signals out, no power."""

from phfmu.components.control.bases import Bases, bases
from phfmu.components.control.diagram import Diagram
from phfmu.components.control.exciters import exac1, ieeex1, sexs, st1a
from phfmu.components.control.governors import gast, hygov, tgov1
from phfmu.components.control.meter import meter
from phfmu.components.control.pi_controller import pi_controller
from phfmu.components.control.relay import relay
from phfmu.components.control.stabilisers import ieeest, pss1a

__all__ = [
    "Bases",
    "Diagram",
    "bases",
    "exac1",
    "gast",
    "hygov",
    "ieeest",
    "ieeex1",
    "meter",
    "pi_controller",
    "pss1a",
    "relay",
    "sexs",
    "st1a",
    "tgov1",
]
