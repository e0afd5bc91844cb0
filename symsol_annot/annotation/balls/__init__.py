"""Symmetry sets of balls, which can fill a part of SO(3)."""
