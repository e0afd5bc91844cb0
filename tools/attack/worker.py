"""A process that attempts one case after the other, each in a fork of itself, and prints a line of JSON for each.

python -m attack.worker ROOT SEED KIND NUMBER...      attempt these cases
python -m attack.worker ROOT bases NAME...            make the valid files first
"""

import json
import sys
import time
from importlib import import_module
from pathlib import Path

import numpy as np

from attack.apart import adopt_orphans, run_apart
from attack.catalogue import BASES, KINDS
from attack.places import Place, Surroundings, keep

_KEPT = 25  # of each failure of a kind
_WORDS = 1500


def main():
    """Make valid files, or attempt cases."""
    root, what, *rest = sys.argv[1:]
    if what == "bases":
        for name in rest:
            BASES[name](Path(root) / name)
    else:
        kind, *numbers = rest
        attempt_all(Path(root), int(what), kind, list(map(int, numbers)))


def attempt_all(root, seed, kind_name, numbers):
    """Attempt some cases of a kind."""
    for module in KINDS[kind_name].modules:  # so that no fork has to
        import_module("symsol_annot_cli.main" if module == "cli" else f"symsol_annot.{module}")
    slug = kind_name.replace(", ", "-").replace(" ", "-")
    kind, place = KINDS[kind_name](root), Place(root / f"{slug}-from-{numbers[0]}")
    adopt_orphans()
    place.prepare()
    surroundings, kept = Surroundings(place), {}
    print(json.dumps("ready"), flush=True)
    for number in numbers:
        place.clear()
        rng = np.random.default_rng([seed, *kind_name.encode(), number])
        start = time.monotonic()
        attempt = kind.attempt(place, number, rng)
        made = time.monotonic() - start
        surroundings.begin()
        ended = run_apart(attempt.action, place.said)
        how, words = ended.how, ended.words
        wrongs = surroundings.wrongs()
        if wrongs and how in ("right", "refused"):
            how, words = "OUTSIDE", "; ".join(wrongs)
        found = {"number": number, "how": how, "seconds": round(ended.seconds, 3), "peak": ended.peak_bytes >> 20}
        if how not in ("right", "refused"):
            found |= {"done": attempt.done, "words": words[-_WORDS:], "made": round(made, 3)}
            kept[how] = kept.get(how, 0) + 1
            if kept[how] <= _KEPT:
                keep(place, root / "kept" / f"{how}-{slug}-{seed}-{number}")
        print(json.dumps(found), flush=True)
    place.clear()


if __name__ == "__main__":
    main()
