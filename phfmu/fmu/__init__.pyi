"""The names of `phfmu.fmu` and where they are defined."""

from phfmu.fmu.export.manifest import PortMap as PortMap
from phfmu.fmu.export.variables import FMUError as FMUError
from phfmu.fmu.importer.reader import FMUInstance as FMUInstance

__all__: list[str]
