"""phfmu: port-Hamiltonian DAEs as co-simulation components whose energy balance is exact.

The public names are listed in `__init__.pyi`, one import a line.  They are loaded when they are first used, so that importing
the package costs nothing.
"""

from phfmu.listed_names import list_names

__version__ = "0.1.0"

list_names(__name__)
