"""Checking a sealed test once its seed was revealed: the same images and bytes, from the seed and the commitment."""

from dataclasses import dataclass
from pathlib import Path

from symsol_annot.errors import DataError, SealError
from symsol_annot.generation.events import OnEvent, ignore
from symsol_annot.generation.executors import OpenExecutor
from symsol_annot.generation.generate import damaged_shards
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.sealing.making import SealedTest, differences, keep_secret, render
from symsol_annot.sealing.secret import COMMITMENT_NAME, Secret, read_commitment
from symsol_annot.sets.manifest import Manifest, read_manifest


@dataclass(frozen=True)
class Checked:
    """What came of making a sealed test again.

    Attributes:
        test: as it was made here.
        other_images: the shards, by name, whose images are not the published ones.
        other_bytes: the shards whose bytes are not, these included.
        other_software: what differs from the software that the test was sealed for, a line each.
    """

    test: SealedTest
    other_images: tuple[str, ...]
    other_bytes: tuple[str, ...]
    other_software: tuple[str, ...]


def revealed_secret(public: Path, seed: int, digest: str | None = None) -> Secret:
    """Return the secret of a published set of images, given the seed that was revealed.

    Args:
        public: the set's folder, with the commitment in it.
        seed: as it was revealed.
        digest: as it was published before the images were; None where that is compared elsewhere.

    Raises:
        SealError: the seed does not fit the commitment, or the set, the commitment beside it and the digest do not
            belong together.
        DataError: the folder is no whole sealed set.
    """
    manifest = read_manifest(public)
    if not manifest.is_sealed:
        raise SealError(f"{public}: is no sealed set, so there is no seal to check; give the folder that was published")
    if digest and digest != manifest.sealed.commitment:
        raise SealError(
            f"{public}: its images are sealed with {manifest.sealed.commitment}, and {digest} was published before: "
            "they are another test's, or were changed after the commitment"
        )
    commitment = read_commitment(public / COMMITMENT_NAME)
    if commitment.digest != manifest.sealed.commitment:
        raise SealError(
            f"{public}: its images are sealed with {manifest.sealed.commitment}, and its {COMMITMENT_NAME} is of "
            f"{commitment.digest}; fetch the folder again"
        )
    secret = commitment.opened_by(seed)
    if lacking := secret.public_manifest().differences(manifest):
        raise SealError(f"{public}: is not the set that was committed to; it differs in {'; '.join(lacking)}")
    missing = [entry.file for entry in manifest.shards if not entry.is_finished] or [
        entry.file for entry in damaged_shards(public, manifest)
    ]
    if missing:
        raise DataError(f"{public}: shards are missing or damaged: {', '.join(missing)}; fetch them again")
    return secret


def check(
    public: Path,
    secret: Secret,
    folder: Path,
    open_executor: OpenExecutor,
    on_event: OnEvent = ignore,
    *,
    given: ObjectSpec | None = None,
) -> Checked:
    """Make a sealed test again, its labels too, and compare its images with the published ones.

    Args:
        public: the published set of images.
        secret: as `revealed_secret` gives it.
        folder: for the test made again; a check that was interrupted goes on there.
        open_executor: from the plan to who makes the shards.
        on_event: told what happens, by one thread at a time.
        given: the object, where it is not built in.

    Raises:
        SealError: the folder holds another test.
        DataError: the object is another one than was sealed.
        OutputError: the folder cannot be written to.
        RenderError: a worker failed; finished shards are kept.
    """
    published = read_manifest(public)
    keep_secret(folder, secret)
    test = render(folder, open_executor, None, on_event, given=given)
    software = tuple(differences(secret.versions, test.versions))
    return Checked(test, *_compared(published, test.public), software)


def _compared(published: Manifest, made: Manifest) -> tuple[tuple[str, ...], tuple[str, ...]]:
    pairs = list(zip(published.shards, made.shards, strict=True))
    other_images = tuple(theirs.file for theirs, ours in pairs if theirs.content_sha256 != ours.content_sha256)
    return other_images, tuple(theirs.file for theirs, ours in pairs if theirs.sha256 != ours.sha256)
