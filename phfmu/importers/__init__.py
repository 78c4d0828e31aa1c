"""Other people's models as declarations."""

from phfmu.importers.lagrangian import from_lagrangian as from_lagrangian
from phfmu.importers.linear import PLAIN as PLAIN
from phfmu.importers.linear import matrices as matrices
from phfmu.importers.reduced import from_pymor as from_pymor
from phfmu.importers.symbolic import from_sympy as from_sympy

__all__ = ["from_lagrangian", "from_pymor", "from_sympy", "matrices"]
