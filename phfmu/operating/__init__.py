"""Operating points of networks: the balanced steady state that meets given voltages and powers."""

from phfmu.listed_names import list_names

list_names(__name__)
