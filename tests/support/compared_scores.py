"""Scores of two methods, the second of which is off by a known angle."""

COMPARED_IMAGES = 40
SHIFT_RAD = 0.02
