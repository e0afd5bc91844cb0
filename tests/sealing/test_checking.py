"""A revealed seed reproduces the published bytes, or what was published is not what was committed to."""

import shutil
from dataclasses import replace

import h5py
import pytest
from sealed_tests import IMAGES, everything_in, plan_to_seal, sealed_test, software, workers
from tampering import put, reseal, tampered

from symsol_annot.errors import DataError, SealError
from symsol_annot.sealing import making
from symsol_annot.sealing.checking import check, revealed_secret
from symsol_annot.sealing.secret import read_secret
from symsol_annot.sets.dataset import load
from symsol_annot.sets.manifest import read_manifest, write_manifest


@pytest.fixture(scope="module")
def seed(made):
    return read_secret(made / "secret.json").settings.seed


def checked(public, seed, folder):
    return check(public, revealed_secret(public, seed), folder, workers())


def test_the_revealed_seed_reproduces_bytes_and_labels(made, seed, tmp_path):
    public = shutil.copytree(made / "public", tmp_path / "public")  # all that a participant has
    found = checked(public, seed, tmp_path / "checked")
    assert (found.other_images, found.other_bytes, found.other_software) == ((), (), ())
    assert everything_in(tmp_path / "checked") == everything_in(made)
    again = checked(public, seed, tmp_path / "checked")
    assert again.test.public == found.test.public


def test_the_digest_that_was_published_is_compared_as_well(made, seed):
    secret = read_secret(made / "secret.json")
    assert revealed_secret(made / "public", seed, secret.digest) == secret
    with pytest.raises(SealError, match=f"{'0' * 64} was published before: they are another test's"):
        revealed_secret(made / "public", seed, "0" * 64)


def test_a_seed_that_does_not_fit_is_refused_in_a_line_and_nothing_is_made(made, seed, tmp_path):
    with pytest.raises(SealError, match=r"^seed [0-9a-f]{32}: does not fit the commitment") as refused:
        checked(made / "public", seed ^ 1, tmp_path / "checked")
    assert "\n" not in str(refused.value)
    assert list(tmp_path.iterdir()) == []


def test_images_of_another_seed_under_the_same_commitment_are_found(folder, seed, tmp_path):
    """A maintainer who commits to one seed and publishes the images of another is found out."""
    other = sealed_test(tmp_path / "other")
    manifest = read_manifest(other / "public")
    ours = read_manifest(folder / "public").settings
    public = folder / "public"
    for entry in manifest.shards:
        shutil.copy(other / "public" / entry.file, public / entry.file)
        with h5py.File(public / entry.file, "r+") as file:
            file.attrs["commitment"] = ours.commitment
    reseal(public)
    assert len(load(public)) == IMAGES  # a sealed set like any other
    found = checked(public, seed, tmp_path / "checked")
    assert found.other_images == found.other_bytes == tuple(entry.file for entry in manifest.shards)


def test_one_image_that_was_exchanged_is_found(folder, seed, tmp_path):
    with tampered(folder / "public", "test-00001-of-00002.h5") as file:
        image = file["image"][...]
        image[3] = image[4]
        put(file, "image", image)
    found = checked(folder / "public", seed, tmp_path / "checked")
    assert found.other_images == ("test-00001-of-00002.h5",)


def test_other_software_at_the_check_is_named_and_no_fault_by_itself(tmp_path):
    made = tmp_path / "made"
    making.seal(plan_to_seal(), {**software(), "renderer": "another", "mesa": "22"}, made)
    test = making.render(made, workers(), None)  # as if that other software had drawn the same pixels
    found = checked(made / "public", test.secret.settings.seed, tmp_path / "checked")
    assert found.other_software == ("mesa: sealed for 22, here None", "renderer: sealed for another, here numpy")
    assert found.other_images == ()


def test_a_commitment_of_another_test_beside_the_images_is_named(folder, seed, tmp_path):
    other = sealed_test(tmp_path / "other")
    shutil.copy(other / "public/commitment.json", folder / "public/commitment.json")
    with pytest.raises(SealError, match="fetch the folder again"):
        revealed_secret(folder / "public", seed)


def test_a_published_set_with_fewer_images_than_were_committed_to_is_refused(folder, seed):
    manifest = read_manifest(folder / "public")
    last = manifest.shards[-1]
    fewer = replace(manifest, shards=(*manifest.shards[:-1], replace(last, images=last.images - 1)))
    write_manifest(folder / "public", fewer)
    with pytest.raises(SealError, match="is not the set that was committed to; it differs in test images"):
        revealed_secret(folder / "public", seed)


def test_a_damaged_copy_is_to_be_fetched_again(folder, seed):
    path = folder / "public/test-00000-of-00002.h5"
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    with pytest.raises(DataError, match=r"missing or damaged: test-00000-of-00002.h5; fetch them again"):
        revealed_secret(folder / "public", seed)


def test_a_set_that_is_not_sealed_has_no_seal_to_check(folder, seed):
    with pytest.raises(SealError, match="is no sealed set"):
        revealed_secret(folder / "labelled", seed)


def test_a_check_is_not_made_over_another_tests(made, folder, seed, tmp_path):
    other = sealed_test(tmp_path / "other")
    before = everything_in(other)
    with pytest.raises(SealError, match="is another sealed test's; it was not touched"):
        checked(made / "public", seed, other)
    assert everything_in(other) == before
