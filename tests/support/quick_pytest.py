"""pytest as a program that looks for one failure, and does not look for a smaller case of it."""

import sys

import hypothesis
import pytest

hypothesis.settings.register_profile(
    "quick", phases=(hypothesis.Phase.explicit, hypothesis.Phase.generate), database=None
)


def main():
    """Run pytest with the words of the command line; return its exit code."""
    hypothesis.settings.load_profile("quick")
    return pytest.main(sys.argv[1:])
