"""The names of `phfmu.components.mechanical.mechanisms` and where they are defined."""

from phfmu.components.mechanical.mechanisms.andrews import andrews as andrews
from phfmu.components.mechanical.mechanisms.box_on_floor import box_on_floor as box_on_floor
from phfmu.components.mechanical.mechanisms.bricard import bricard as bricard
from phfmu.components.mechanical.mechanisms.car_axis import car_axis as car_axis
from phfmu.components.mechanical.mechanisms.flyball import flyball as flyball
from phfmu.components.mechanical.mechanisms.gear_train import gear_train as gear_train
from phfmu.components.mechanical.mechanisms.pendulum import pendulum as pendulum
from phfmu.components.mechanical.mechanisms.rope_bridge import rope_bridge as rope_bridge
from phfmu.components.mechanical.mechanisms.slider_crank import slider_crank as slider_crank
from phfmu.components.mechanical.mechanisms.ur5 import ur5 as ur5

__all__: list[str]
