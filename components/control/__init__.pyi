"""The names of `phfmu.components.control` and where they are defined."""

from phfmu.components.control.bases import Bases as Bases
from phfmu.components.control.bases import bases as bases
from phfmu.components.control.diagram import Diagram as Diagram
from phfmu.components.control.exciters import exac1 as exac1
from phfmu.components.control.exciters import ieeex1 as ieeex1
from phfmu.components.control.exciters import sexs as sexs
from phfmu.components.control.exciters import st1a as st1a
from phfmu.components.control.governors import gast as gast
from phfmu.components.control.governors import hygov as hygov
from phfmu.components.control.governors import tgov1 as tgov1
from phfmu.components.control.meter import meter as meter
from phfmu.components.control.pi_controller import pi_controller as pi_controller
from phfmu.components.control.relay import relay as relay
from phfmu.components.control.stabilisers import ieeest as ieeest
from phfmu.components.control.stabilisers import pss1a as pss1a

__all__: list[str]
