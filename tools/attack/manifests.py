"""Manifests, edited and signed again, with shards that say the same: what loads obeys the laws, or is refused."""

import json

import h5py
import numpy as np

from attack.commands import outcome_of_command
from attack.damage import ODD_VALUES, damage_json
from attack.kinds import READING_SETS, Attempt, Kind
from attack.sets import put_set, read_originals
from attack.shards import load_and_hold, verify_and_hold
from attack.signing import read_document, sign

_LIKELY = ("object", "camera", "render", "tolerance_px", "annotate", "seed", "splits", "source", "object_sha256")
_TEXTS = {"camera", "render", "source"}  # attributes that are JSON


class Manifests(Kind):
    """One to three places of a manifest changed; the shards' attributes follow in most."""

    name, cases = "manifests, signed again", 1000
    modules, bases = READING_SETS, ("sets",)

    def __init__(self, root):
        self._originals = read_originals(root / "sets")

    def attempt(self, place, number, rng):
        original = self._originals[rng.integers(len(self._originals))]
        folder = put_set(original, place.case)
        document = read_document(folder)
        done = _edit(document, rng)
        if rng.random() < 0.7:
            follow(folder, document)
            done.append("shards follow")
        sign(folder, document, contents=False)
        return Attempt([original.folder.parent.name, original.name, *done], _action(original, folder, place, rng))


def _edit(document, rng):
    kind = rng.random()
    if kind < 0.3:
        name = _LIKELY[rng.integers(len(_LIKELY))]
        document[name] = ODD_VALUES[rng.integers(len(ODD_VALUES))]
        return [f"{name} = {str(document[name])[:60]!r}"]
    if kind < 0.55:
        return [_near(document, rng)]
    if kind < 0.6:
        return _many_entries(document, int(rng.choice([1000, 20_000])))
    return damage_json(document, rng)


def _near(document, rng):
    """Give a number another value, not far from its own, and all else what follows from it."""
    render, camera, entry = document["render"] or {}, document["camera"], document["splits"]["test"]["shards"][0]
    numbers = [(holder, key) for holder in (document, camera, render, entry) for key in holder]
    numbers = [(holder, key) for holder, key in numbers if type(holder[key]) in (int, float)]
    holder, key = numbers[rng.integers(len(numbers))]
    holder[key] = type(holder[key])(holder[key] * float(rng.choice([0.5, 1.01, 2, 1000])) + float(rng.choice([0, 1])))
    for split in document["splits"].values():
        split["images"] = sum(one["images"] for one in split["shards"])
    return f"{key} near its own: {holder[key]}"


def _many_entries(document, count):
    split = document["splits"]["test"]
    first, step = split["shards"][0], split["shards"][0]["images"]
    split["shards"] = [dict(first, file=f"test-{i:05d}-of-{count:05d}.h5", first_index=step * i) for i in range(count)]
    split["images"] = step * count
    return [f"{count} entries"]


def follow(folder, document):
    """Let the shards' attributes say what the manifest says, as far as HDF5 holds that."""
    for path in folder.glob("*.h5"):
        with h5py.File(path, "r+") as file:
            for name in (set(file.attrs) & set(document)) - {"format", "format_version"}:
                value = document[name]
                try:
                    if name in _TEXTS:
                        file.attrs[name] = json.dumps(value, sort_keys=True)
                    else:
                        file.attrs[name] = np.nan if value is None else value
                    if name == "render":
                        file.attrs["engine"] = value["engine"]
                except (TypeError, ValueError, KeyError, OverflowError, RecursionError, UnicodeError, OSError):
                    continue


def _action(original, folder, place, rng):
    kind = rng.random()
    if kind < 0.45:
        return lambda: load_and_hold(original, folder, is_signed=True)
    if kind < 0.65:
        return lambda: verify_and_hold(original, folder, is_signed=True, by_command=kind > 0.55)
    if kind < 0.85:
        return lambda: outcome_of_command("info", folder)
    if kind < 0.9:
        return lambda: outcome_of_command("plot", "images", folder, "--out", place.out / "sheet.png")
    if kind < 0.95:
        return lambda: outcome_of_command("publish", folder, "--out", place.out / "bundle")
    return lambda: outcome_of_command("gallery", folder, "--redrawn", "0", "--out", place.out / "gallery")
