"""Junctions: what joins members, their equations, and the network as one model."""
