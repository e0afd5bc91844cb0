"""Shards, damaged: under the manifest of the whole ones, so that its digests tell; or signed again."""

import inspect

import fuzz_predictions

from attack import laws, odd_shards
from attack.commands import outcome_of_command
from attack.hdf5_fields import damage_fields, fields_of, with_right_checksums
from attack.kinds import READING_SETS, Attempt, Kind
from attack.sets import LABELS, put_set, read_originals
from attack.signing import read_document, sign

_ROWS = 8  # read one by one


class Shards(Kind):
    """Shards that the manifest's digests are not of: what loads is what was there before, or is refused."""

    name, cases, is_signed = "shards", 4000, False
    modules, bases = READING_SETS, ("sets",)

    def __init__(self, root):
        self._originals = read_originals(root / "sets")
        self._fields = {path: fields_of(path.read_bytes()) for one in self._originals for path in one.shards}

    def attempt(self, place, number, rng):
        original = self._originals[rng.integers(len(self._originals))]
        folder = put_set(original, place.case)
        shard = original.shards[rng.integers(len(original.shards))]
        done = self._damage(folder / shard.name, self._fields[shard], place, rng)
        if self.is_signed:
            sign(folder, read_document(folder), contents=rng.random() < 0.8)
        return Attempt(
            [original.folder.parent.name, original.name, shard.name, *done], self._action(original, folder, place, rng)
        )

    def _damage(self, path, fields, place, rng):
        """Damage a shard in place; return what was done."""
        before, kind, done = path.read_bytes(), rng.random(), []
        content = bytearray(before)
        if kind < 0.55:
            done = damage_fields(content, fields, rng)
        elif kind < 0.8:
            damage = fuzz_predictions.BYTES[rng.integers(len(fuzz_predictions.BYTES))]
            damage(content, rng)
            done = [damage.__name__]
        else:
            done = odd_shards.rewrite(path, place, rng)
            content = bytearray(path.read_bytes())
            if rng.random() < 0.3:
                at = int(rng.integers(min(len(content), 4096)))
                content[at] ^= 1 << int(rng.integers(8))
                content = with_right_checksums(content)
                done.append(f"flipped a bit at {at}")
        if content == before:
            content[-1] ^= 1
            done.append("flipped the last bit")
        path.write_bytes(content)
        return done

    def _action(self, original, folder, place, rng):
        kind, is_backwards = rng.random(), bool(rng.random() < 0.5)
        if kind < 0.75:
            return lambda: load_and_hold(original, folder, is_signed=self.is_signed, is_backwards=is_backwards)
        if kind < 0.8:
            return lambda: load_and_hold(original, folder, is_signed=True, is_backwards=is_backwards, check=False)
        if kind < 0.92 or not self.is_signed:
            return lambda: verify_and_hold(original, folder, is_signed=self.is_signed, by_command=kind > 0.85)
        if kind < 0.96:
            return lambda: outcome_of_command("info", folder)
        return lambda: outcome_of_command("plot", "images", folder, "--out", place.out / "sheet.png")


class SignedShards(Shards):
    """The same, signed again: what loads obeys the laws, or is refused."""

    name, cases, is_signed = "shards, signed again", 1000, True


def load_and_hold(original, folder, *, is_signed, is_backwards=False, check=True):
    """Load a set, its labels and some of its images, and hold them against the whole set, or against the laws.

    Returns:
        "right"; what is refused raises an error of the package's.

    Raises:
        SilentError: they are wrong, and nothing was said.
    """
    from symsol_annot import load

    options = {} if check or "check" not in inspect.signature(load).parameters else {"check": False}
    with load(folder, original.split, **options) as dataset:
        steps = [_hold_labels, _hold_samples]
        for step in reversed(steps) if is_backwards else steps:
            step(dataset, original, is_signed=is_signed)
    return "right"


def _hold_labels(dataset, original, *, is_signed):
    if not dataset.is_annotated:
        return
    labels = dataset.labels()
    if is_signed:
        laws.check_labels(labels, has_marking=dataset.has_marking)
        return
    for name in LABELS:
        if name in original.columns:
            laws.check_same(getattr(labels, name), original.columns[name], name)
    laws.check_same(labels.symmetry_group, original.group, "symmetry_group")


def _hold_samples(dataset, original, *, is_signed):
    count = len(dataset)
    for i in dict.fromkeys([*range(min(count, _ROWS)), count - 1]):
        sample = dataset[i]
        if is_signed:
            laws.check_sample(sample, dataset.image_size, len(dataset.parts))
            continue
        for name in ("image", "segmentation", "depth", *LABELS):
            found = getattr(sample, name)
            if name in original.columns:
                laws.check_same(found, original.columns[name][i], f"{name} of image {i}")
        laws.check_same(sample.symmetry_group, original.group, "symmetry_group")


def verify_and_hold(original, folder, *, is_signed, by_command):
    """Verify a set; where it is called whole, what is in it must be.

    Raises:
        SilentError: it is not.
    """
    from symsol_annot.sets.verify import verify

    is_whole = outcome_of_command("verify", folder) == "right" if by_command else not verify(folder)
    if not is_whole:
        return "refused"
    if not is_signed and any((folder / path.name).read_bytes() != path.read_bytes() for path in original.shards):
        raise laws.SilentError("verify calls a shard whole that has not the digest in the manifest")
    return load_and_hold(original, folder, is_signed=True)
