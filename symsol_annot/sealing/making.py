"""Making a sealed test: first its secret and the commitment, later its images with labels, and without."""

import secrets
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from symsol_annot.errors import SealError, output_errors
from symsol_annot.generation.events import OnEvent, ignore
from symsol_annot.generation.executors import OpenExecutor
from symsol_annot.generation.generate import damaged_shards, generate
from symsol_annot.generation.origin import plan_behind
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.sealing.images import write_images
from symsol_annot.sealing.secret import (
    COMMITMENT_NAME,
    LABELLED,
    PUBLIC,
    SECRET_NAME,
    SPLIT,
    Secret,
    read_commitment,
    read_secret,
    write_secret,
)
from symsol_annot.sets.manifest import MANIFEST_NAME, Manifest, read_manifest
from symsol_annot.sets.plan import SetPlan
from symsol_annot.sets.shard.reader import open_shard
from symsol_annot.sets.stated.values import SECRET_SEED_BITS
from symsol_annot.system.files import make_folder, write_atomically
from symsol_annot.system.locks import held_folder

_Software = Callable[[SetPlan], dict[str, str]]  # name to version


@dataclass(frozen=True)
class SealedTest:
    """A sealed test that was made.

    Attributes:
        secret: of it.
        labelled: the manifest of the set with its labels.
        public: the manifest of the set of its images alone.
        versions: the software that both were made with here: name to version.
    """

    secret: Secret
    labelled: Manifest
    public: Manifest
    versions: dict[str, str]


def seal(plan: SetPlan, versions: dict[str, str], folder: Path) -> Secret:
    """Draw a secret seed, and write the secret and the commitment to it.

    Args:
        plan: of the set, whose own seed counts for nothing.
        versions: the software that is to draw it: name to version.
        folder: of the sealed test.

    Raises:
        SealError: the folder holds one already, or the object is of format version 2; nothing was touched.
        OutputError: the folder cannot be written to, or another process is making the test.
    """
    if plan.spec.has_general_rule:
        raise SealError(
            f"{plan.spec.name!r} is an object of format version 2, of which no sealed tests can be made yet; nothing "
            "was touched"
        )
    seed = secrets.randbits(SECRET_SEED_BITS)
    settings = SetPlan(plan.spec, plan.images, seed, plan.camera, plan.settings, SPLIT).set_settings
    secret = Secret(settings, plan.images[SPLIT], versions)
    with held_folder(folder):
        there = [name for name in (SECRET_NAME, COMMITMENT_NAME, LABELLED, PUBLIC) if (folder / name).exists()]
        if there:
            raise SealError(
                f"{folder}: holds {there[0]} of a sealed test already, and nothing was touched; seal into another "
                "folder (--out)"
            )
        keep_secret(folder, secret)
    return secret


def keep_secret(folder: Path, secret: Secret) -> None:
    """Write a secret and its commitment into a folder, unless they are there already.

    Raises:
        SealError: another secret or commitment is there; it was not touched.
        OutputError: they cannot be written.
    """
    make_folder(folder)
    for name, read, ours in (
        (SECRET_NAME, read_secret, secret),
        (COMMITMENT_NAME, read_commitment, secret.commitment),
    ):
        path = folder / name
        if path.exists():
            if read(path) != ours:
                raise SealError(f"{path}: is another sealed test's; it was not touched. Choose another folder (--out)")
        elif name == SECRET_NAME:
            write_secret(path, secret)
        else:
            write_atomically(path, secret.commitment.to_bytes())


def render(
    folder: Path,
    open_executor: OpenExecutor,
    software: _Software | None,
    on_event: OnEvent = ignore,
    *,
    given: ObjectSpec | None = None,
) -> SealedTest:
    """Make the set with labels of a sealed test, and the set of its images; what is there already stays.

    Args:
        folder: of the sealed test, with its secret.
        open_executor: from the plan to who makes the shards.
        software: from the plan to the software here, which has to be what the test was sealed for; None lets any.
        on_event: told what happens, by one thread at a time.
        given: the object, where it is not built in.

    Raises:
        SealError: there is no secret, or what is there is not of it, or other software is here.
        DataError: the object is another one than was sealed, or a shard is damaged.
        OutputError: the folder cannot be written to, or another process is making the test.
        RenderError: a worker failed; finished shards are kept.
    """
    secret = read_secret(folder / SECRET_NAME)
    plan = plan_behind(folder, secret.labelled_manifest(), given)
    labelled = folder / LABELLED
    with held_folder(folder):
        keep_secret(folder, secret)
        if software and not _is_finished(labelled):
            _refuse_other_software(folder, secret, software(plan))
        with output_errors(labelled):
            labelled.mkdir(mode=0o700, exist_ok=True)
        made = generate(plan, labelled, open_executor, on_event)
        public = _public_there(folder / PUBLIC, secret)
        public = public or write_images(secret, labelled, made, plan.spec.symmetry_group, folder / PUBLIC)
    return SealedTest(secret, made, public, versions_of(labelled, made))


def versions_of(folder: Path, manifest: Manifest) -> dict[str, str]:
    """Return the software that a finished set was made with: name to version."""
    with open_shard(folder / manifest.shards[0].file) as shard:
        return shard.versions


def differences(theirs: dict[str, str], ours: dict[str, str]) -> list[str]:
    """Say which software differs from what a test was sealed for, a line each."""
    names = sorted(name for name in {*theirs, *ours} if theirs.get(name) != ours.get(name))
    return [f"{name}: sealed for {theirs.get(name)}, here {ours.get(name)}" for name in names]


def _is_finished(folder: Path) -> bool:
    return (folder / MANIFEST_NAME).exists() and read_manifest(folder).is_finished


def _refuse_other_software(folder: Path, secret: Secret, here: dict[str, str]) -> None:
    found = differences(secret.versions, here)
    if found:
        raise SealError(
            f"{folder}: was sealed for other software than is here ({'; '.join(found)}), so that the images that are "
            "made here might not be those of others; install that, or seal anew before the commitment is published"
        )


def _public_there(folder: Path, secret: Secret) -> Manifest | None:
    """Return the manifest of the images that an earlier run wrote, None where none did; refuse anything else."""
    with output_errors(folder):
        if not folder.exists() or not any(folder.iterdir()):
            return None
    manifest = read_manifest(folder)
    is_ours = manifest.is_sealed and manifest.sealed.commitment == secret.digest and manifest.is_finished
    if not is_ours or damaged_shards(folder, manifest):
        raise SealError(
            f"{folder}: holds other files than this test's images, or damaged ones; they are left as they are. Move "
            "them elsewhere: the same command writes the images again"
        )
    return manifest
