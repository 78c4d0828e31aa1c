"""Controllers: signals in, signals out, no power."""

from phfmu.components.control.pi_controller import pi_controller
from phfmu.components.control.relay import relay

__all__ = [
    "pi_controller",
    "relay",
]
