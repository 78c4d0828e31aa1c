"""Parts of three-phase networks: lines, transformers, loads, shunts, faults; currents count into the component."""

from phfmu.listed_names import list_names

list_names(__name__)
