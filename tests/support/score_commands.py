"""The commands that score, in processes of their own."""

from command_line import COMMAND, symsol

__all__ = ["COMMAND", "IMAGES", "symsol"]
IMAGES = {"tetX": 24, "cylO": 4}
