"""A shard that is not the manifest's is an error, and never a sample."""

import shutil

import pytest
from made_sets import make_set
from read_samples import PER_SHARD
from tampering import reseal, tampered

from symsol_annot.errors import DataError
from symsol_annot.sets.dataset import load


def test_shard_with_fewer_images_than_the_manifest_says_is_an_error(tetX_set):
    shutil.copy(tetX_set / "test-00002-of-00003.h5", tetX_set / "test-00001-of-00003.h5")
    with tampered(tetX_set, "test-00001-of-00003.h5") as file:
        file.attrs["first_index"] = PER_SHARD
    with pytest.raises(DataError, match=r"test-00001-of-00003\.h5: .*\n.*expected 16 images, found 8"):
        load(tetX_set)[2 * PER_SHARD - 1]


@pytest.mark.parametrize("other", ["of another place", "of another seed", "of another split", "of another object"])
def test_shard_of_something_else_is_an_error_and_never_a_sample(tetX_set, tmp_path, other):
    path = tetX_set / "test-00000-of-00003.h5"
    made = {
        "of another place": lambda: tetX_set / "test-00001-of-00003.h5",
        "of another seed": lambda: make_set(tmp_path / "other", test=16, seed=1) / "test-00000-of-00001.h5",
        "of another split": lambda: tetX_set / "train-00000-of-00001.h5",
        "of another object": lambda: make_set(tmp_path / "other", "tet", test=16) / "test-00000-of-00001.h5",
    }
    shutil.copy(made[other](), path)
    with pytest.raises(DataError, match=r"test-00000-of-00003\.h5: is damaged: expected"):
        load(tetX_set)[0]
    for check in (False, True):
        with pytest.raises(DataError, match=r"test-00000-of-00003\.h5: is no shard of this set:\n"):
            load(tetX_set, check=check)[0]
        reseal(tetX_set)
