"""Networks of the tables that `phfmu.importers.grid` reads: parts, operating point, faults and trips."""

from phfmu.listed_names import list_names

list_names(__name__)
