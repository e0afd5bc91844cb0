"""What this machine has for this process: cores, and the packages of the installation's extras."""

import os
from importlib.util import find_spec

from symsol_annot.errors import MissingExtraError

# Extra: what it brings, by the name that it is imported by. Blender's module has a check of its own.
PACKAGES = {
    "plot": ("matplotlib",),
    "publish": ("pyarrow",),
    "gallery": ("plotly",),
    "bench": ("torch", "roma", "safetensors"),
    "cluster": ("distributed",),
    "tensorboard": ("tensorboard",),
}


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_extra(extra: str, what: str) -> None:
    """Raise where something that is about to begin lacks a package of an extra; no package is imported.

    Args:
        extra: its name, a key of `PACKAGES`.
        what: what needs it, to begin the message with: "plotting".

    Raises:
        MissingExtraError: a package is not installed.
    """
    for package in PACKAGES[extra]:
        if find_spec(package) is None:
            raise MissingExtraError(what, package, extra)
