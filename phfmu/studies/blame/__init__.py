"""Planted faults: how often the audit's `--why` names the one that makes the energy."""
