"""The sample set inside the package: a few hundred real images of two objects, there right after install."""

from importlib import resources
from pathlib import Path

from symsol_annot.errors import DataError
from symsol_annot.sets.dataset import Dataset, load

SAMPLE_OBJECTS = ("cylO", "tetX")


def load_sample(object_name: str = "cylO", split: str = "test") -> Dataset:
    """Open a split of the sample set, like `load_sample("tetX", split="train")`.

    It is an ordinary set with symmetry sets in both splits, small but rendered as the published one is, with views that
    show the marking, hide it and barely show it. Its `folder` is what the commands take. Scores on it do not rank.

    Args:
        object_name: "cylO" or "tetX".
        split: "train" or "test".

    Raises:
        DataError: the sample has no such object or split.
    """
    if object_name not in SAMPLE_OBJECTS:
        raise DataError(
            f"the sample set has {' and '.join(SAMPLE_OBJECTS)}, found {object_name!r}; "
            "`symsol-annot render --object NAME` makes sets of the other objects"
        )
    return load(sample_folder() / object_name, split)


def sample_folder() -> Path:
    """Return the folder that holds the sample's sets."""
    return Path(str(resources.files("symsol_annot"))) / "sample_data"
