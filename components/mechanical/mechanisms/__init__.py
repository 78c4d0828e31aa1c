"""Mechanisms of rigid bodies and joints, most of them benchmarks with known solutions."""

from phfmu.components.mechanical.mechanisms.andrews import andrews
from phfmu.components.mechanical.mechanisms.box_on_floor import box_on_floor
from phfmu.components.mechanical.mechanisms.bricard import bricard
from phfmu.components.mechanical.mechanisms.car_axis import car_axis
from phfmu.components.mechanical.mechanisms.flyball import flyball
from phfmu.components.mechanical.mechanisms.gear_train import gear_train
from phfmu.components.mechanical.mechanisms.pendulum import pendulum
from phfmu.components.mechanical.mechanisms.rope_bridge import rope_bridge
from phfmu.components.mechanical.mechanisms.slider_crank import slider_crank
from phfmu.components.mechanical.mechanisms.ur5 import ur5

__all__ = [
    "andrews",
    "box_on_floor",
    "bricard",
    "car_axis",
    "flyball",
    "gear_train",
    "pendulum",
    "rope_bridge",
    "slider_crank",
    "ur5",
]
