"""Diffusion on SO(3): a network that tells noisy rotations which way to turn, learnt without symmetry sets."""
