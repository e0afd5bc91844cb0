"""Implicit-PDF: a density on SO(3) by a softmax over rotations that are asked about (Murphy et al., ICML 2021)."""
