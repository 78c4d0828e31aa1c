"""Other people's models as declarations."""

from phfmu.importers.linear import PLAIN as PLAIN
from phfmu.importers.linear import matrices as matrices
