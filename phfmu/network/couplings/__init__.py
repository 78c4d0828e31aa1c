"""Couplings: how the steps of a network are taken, one file each."""
