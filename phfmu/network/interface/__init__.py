"""The interface of members stepped apart: rows of junctions and signals, what is exchanged, values at an instant."""
