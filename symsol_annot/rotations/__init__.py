"""Rotations: distances, groups, the nearest of a set, the equivolumetric grid."""
