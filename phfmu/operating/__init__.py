"""Operating points of networks: the balanced steady state that meets given voltages and powers."""

from phfmu.operating.point import NetworkPoint, operating_point
from phfmu.operating.specifications import PQ, PV, Load, Slack, Specification
from phfmu.operating.system import NoOperatingPoint

__all__ = ["PQ", "PV", "Load", "NetworkPoint", "NoOperatingPoint", "Slack", "Specification", "operating_point"]
