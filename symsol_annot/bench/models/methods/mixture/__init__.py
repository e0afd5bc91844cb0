"""A mixture density on SO(3), from which all three tracks follow."""
