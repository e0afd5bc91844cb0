"""The labels of a sealed set, for those who have its secret."""

from collections.abc import Sequence
from pathlib import Path

from symsol_annot.errors import SealError
from symsol_annot.sealing.images import refuse_other_images
from symsol_annot.sealing.secret import LABELLED, SPLIT, Secret, read_secret
from symsol_annot.sets.dataset import Dataset, load
from symsol_annot.sets.manifest import MANIFEST_NAME


def labelled_split(sealed: Dataset, secrets: Sequence[Path]) -> Dataset:
    """Open the set with the labels of a sealed set, which lies beside its secret.

    Args:
        sealed: the images.
        secrets: files, of which one has to be the secret of this set.

    Raises:
        SealError: none of the secrets is this set's, or the set beside it is not the one that it seals.
        DataError: that set is damaged or not finished.
    """
    path, secret = _fitting(sealed, secrets)
    folder = path.parent / LABELLED
    if not (folder / MANIFEST_NAME).exists():
        raise SealError(f"{folder}: holds no labels yet; `symsol-annot seal render {path.parent}` makes them")
    labelled = load(folder, SPLIT)
    differences = secret.labelled_manifest().differences(labelled.manifest)
    if differences:
        raise SealError(f"{folder}: is not the set that {path} seals; it differs in {'; '.join(differences)}")
    refuse_other_images(sealed.manifest, sealed.folder, labelled.manifest, folder)
    return labelled


def _fitting(sealed: Dataset, secrets: Sequence[Path]) -> tuple[Path, Secret]:
    wanted = sealed.manifest.sealed.commitment
    found = [(path, read_secret(path)) for path in secrets]
    for path, secret in found:
        if secret.digest == wanted:
            return path, secret
    theirs = ", ".join(f"{path} has {secret.digest[:16]}" for path, secret in found)
    raise SealError(
        f"{sealed.folder}: is sealed with a secret of digest {wanted[:16]}, and {theirs}: it is another test's; "
        "--secret names the file"
    )
