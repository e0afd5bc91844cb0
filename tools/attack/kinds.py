"""What every kind of attack is: valid files, made once, and attempts at them, each by its number alone."""

from collections.abc import Callable
from typing import NamedTuple

READING_SETS = ("sets.dataset", "sets.verify", "sets.statistics", "plotting.contact_sheet", "cli")
SCORING = ("bench.scoring.scoring", "bench.scoring.reports.report", "bench.scoring.reports.comparison", "cli")


class Attempt(NamedTuple):
    """One attempt.

    Attributes:
        done: what was done to valid files, in words.
        action: what is to be run on them; returns "right" or "refused", or raises.
    """

    done: list
    action: Callable


class Kind:
    """A kind of attack.

    Attributes:
        name: of it.
        cases: how many attempts there are in a whole run; None for one that has as many as it lists.
        modules: of the package, that its processes import once and for all.
        bases: the folders of valid files that it is made from; `BASES` of catalogue.py says what makes them.
    """

    name = ""
    cases = 0
    modules = ()
    bases = ()

    def __init__(self, root):
        """Read the folders of valid files, which lie in `root`."""

    def attempt(self, place, number, rng):
        """Write the damaged files of an attempt into place.case; return the attempt."""
        raise NotImplementedError
