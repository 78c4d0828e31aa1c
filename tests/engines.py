"""The engines that a test takes one after the other."""

from __future__ import annotations

from phfmu import NativeInstance, PythonInstance

ENGINES = (PythonInstance, NativeInstance)
BY_NAME = {"python": PythonInstance, "native": NativeInstance}
