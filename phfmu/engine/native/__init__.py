"""Instances in compiled code."""
