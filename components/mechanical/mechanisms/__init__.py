"""Mechanisms of rigid bodies and joints, most of them benchmarks with known solutions."""

from phfmu.components.mechanical.mechanisms.andrews import andrews
from phfmu.components.mechanical.mechanisms.bricard import bricard
from phfmu.components.mechanical.mechanisms.flyball import flyball
from phfmu.components.mechanical.mechanisms.pendulum import pendulum
from phfmu.components.mechanical.mechanisms.slider_crank import slider_crank

__all__ = ["andrews", "bricard", "flyball", "pendulum", "slider_crank"]
