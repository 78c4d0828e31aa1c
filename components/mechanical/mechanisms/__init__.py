"""Mechanisms of rigid bodies and joints, most of them benchmarks with known solutions."""

from phfmu.listed_names import list_names

list_names(__name__)
