"""The names of `phfmu.operating` and where they are defined."""

from phfmu.operating.point import NetworkPoint as NetworkPoint
from phfmu.operating.point import operating_point as operating_point
from phfmu.operating.specifications import PQ as PQ
from phfmu.operating.specifications import PV as PV
from phfmu.operating.specifications import Load as Load
from phfmu.operating.specifications import Slack as Slack
from phfmu.operating.specifications import Specification as Specification
from phfmu.operating.system import NoOperatingPoint as NoOperatingPoint

__all__: list[str]
