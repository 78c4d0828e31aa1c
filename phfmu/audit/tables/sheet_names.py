"""Units and kinds of tables by the names users know; imports little, so that the command line stays fast."""

from phfmu.audit.kinds import RowKind

#: units an audit may be read in, in J
UNITS = {
    "J": 1.0,
    "kJ": 1e3,
    "MJ": 1e6,
    "GJ": 1e9,
    "TJ": 1e12,
    "mJ": 1e-3,
    "uJ": 1e-6,
    "Wh": 3.6e3,
    "kWh": 3.6e6,
    "MWh": 3.6e9,
}
#: tables that can be asked for
KINDS = tuple(kind.value for kind in RowKind if kind not in (RowKind.NETWORK, RowKind.HASH))
#: rows of a table that are printed unless all are asked for
ROWS = 24
