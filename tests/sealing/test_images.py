"""What is published of a sealed test tells no label: its bytes are a function of the pixels and of public facts."""

import shutil
from dataclasses import replace

import h5py
import numpy as np
import pytest
from sealed_tests import IMAGES, NAME, SEED, everything_in, found_by_metadata, manifest_of, plan_to_seal
from tampering import reseal

from symsol_annot.errors import DataError, NotAnnotatedError, SettingsError
from symsol_annot.rotations.so3 import uniform_rotations
from symsol_annot.sealing.images import write_images
from symsol_annot.sealing.secret import read_secret
from symsol_annot.sets.dataset import load
from symsol_annot.sets.manifest import read_manifest, write_manifest
from symsol_annot.sets.plan import label_rotation
from symsol_annot.sets.stated.values import MAX_SEED, seed_to_json
from symsol_annot.sets.verify import verify

FIRST = "test-00000-of-00002.h5"


def test_images_are_those_of_the_labelled_set_and_there_is_nothing_else(made):
    public, labelled = load(made / "public"), load(made / "labelled")
    assert len(public) == len(labelled) == IMAGES
    for sample, full in zip(public, labelled, strict=True):
        assert np.array_equal(sample.image, full.image)
        assert np.isnan(sample.rotation).all()
        assert np.isnan(sample.marking_pixels)
        assert {sample.segmentation, sample.marking_visible, sample.symmetry_mask, sample.depth} == {None}
        assert sample.part_pixels is None
        with pytest.raises(NotAnnotatedError, match="is sealed"):
            sample.symmetry_set  # noqa: B018
    with pytest.raises(NotAnnotatedError, match="the test split is sealed: its labels are with whoever has its secret"):
        public.labels()
    assert verify(made / "public") == verify(made / "labelled") == []


def test_a_published_shard_has_images_and_public_attributes_alone(made):
    public = {"format", "format_version", "object", "object_sha256", "split", "first_index", "camera", "render"}
    public |= {"versions", "symmetry_group", "symmetry_group_sha256", "commitment"}
    assert sorted(path.name for path in (made / "public").iterdir())[:2] == ["commitment.json", "manifest.json"]
    for path in (made / "public").glob("*.h5"):
        with h5py.File(path) as file:
            assert set(file) == {"image"}
            assert set(file.attrs) == public


def test_other_labels_of_the_same_images_are_published_as_the_same_bytes(made, tmp_path):
    """Whatever the labels are, the participants' files are these: so nothing of the labels is in them."""
    secret, group = read_secret(made / "secret.json"), plan_to_seal().spec.symmetry_group
    other = shutil.copytree(made / "labelled", tmp_path / "other")
    rng = np.random.default_rng(1)
    for path in other.glob("*.h5"):
        with h5py.File(path, "r+") as file:
            count = len(file["image"])
            file["rotation"][...] = uniform_rotations(count, rng)
            file["segmentation"][...] = rng.integers(0, 3, file["segmentation"].shape)
            file["symmetry_mask"][...] = rng.random(file["symmetry_mask"].shape) < 0.5
            file["part_pixels"][...] = file["marking_pixels"][...] = 0.0
            file["marking_pixels"][...] = rng.random(count)
            file.attrs["secret_seed"] = f"{rng.integers(2**60):032x}"
            file.attrs["candidates_drawn"] = 12345
    reseal(other)
    changed = read_manifest(other)
    assert changed.fingerprint != read_manifest(made / "labelled").fingerprint
    write_images(secret, other, changed, group, tmp_path / "public")
    assert everything_in(tmp_path / "public") == everything_in(made / "public")


def test_no_byte_of_the_secret_or_of_a_label_stands_in_what_is_published(made):
    secret = read_secret(made / "secret.json")
    seed, labelled = secret.settings.seed, manifest_of(made / "labelled")
    needles = [secret.seed_hex.encode(), str(seed).encode(), seed.to_bytes(16, "big"), seed.to_bytes(16, "little")]
    needles += [half.encode() for half in (secret.seed_hex[:16], secret.seed_hex[16:])]
    needles += [labelled["fingerprint"].encode(), labelled["splits"]["test"]["fingerprint"].encode()]
    for shard in labelled["splits"]["test"]["shards"]:
        needles += [shard["sha256"].encode(), shard["content_sha256"].encode(), str(shard["bytes"]).encode()]
    labels = load(made / "labelled").labels()
    for R in labels.rotation:
        needles += [R.astype("<f8").tobytes()[:16], R.astype("<f4").tobytes()[:8], repr(float(R[0, 0]))[:12].encode()]
    for data in everything_in(made / "public").values():
        assert [needle for needle in needles if needle in data] == []
    for name, data in everything_in(made / "labelled").items():  # where the same search finds the seed
        assert secret.seed_hex.encode() in data, name


def test_metadata_give_the_labels_of_an_ordinary_set_and_not_those_of_a_sealed_one(made, tetX_set):
    ordinary, labels = load(tetX_set), load(made / "labelled").labels()
    assert found_by_metadata(tetX_set, ordinary[0].rotation) == 0
    assert found_by_metadata(made / "labelled", labels.rotation[0]) == read_secret(made / "secret.json").settings.seed
    assert found_by_metadata(made / "public", labels.rotation[0]) is None


def test_all_128_bits_of_a_seed_decide_the_rotations():
    before = label_rotation(SEED, NAME, "test", 0)
    assert seed_to_json(SEED) == f"{SEED:032x}"
    assert seed_to_json(MAX_SEED) == MAX_SEED
    for bit in range(128):
        assert not np.allclose(label_rotation(SEED ^ 1 << bit, NAME, "test", 0), before)


def test_rotations_of_a_sealed_test_are_those_of_its_seed_in_the_images_order(made):
    seed = read_secret(made / "secret.json").settings.seed
    for sample in load(made / "labelled"):
        assert np.array_equal(sample.rotation, label_rotation(seed, NAME, "test", sample.index))


def test_sealed_images_have_no_segmentation_for_torch(made):
    pytest.importorskip("torch")
    from symsol_annot.torch import SymsolDataset

    with pytest.raises(SettingsError, match="is sealed, and has none"):
        SymsolDataset(made / "public", "test", segmentation=True)


# What nobody signs again


@pytest.mark.parametrize("name", ["rotation", "segmentation", "symmetry_mask", "marking_pixels"])
def test_a_sealed_shard_with_a_label_is_no_shard(folder, name):
    path, full = folder / "public" / FIRST, folder / "labelled" / FIRST
    with h5py.File(path, "r+") as file, h5py.File(full) as labelled:
        labelled.copy(name, file)
    reseal(folder / "public")
    with pytest.raises(DataError, match=f"'{name}' is not part of a sealed shard"):
        load(folder / "public")[0]


def test_a_sealed_shard_of_another_commitment_is_not_of_the_set(folder):
    path = folder / "public" / FIRST
    with h5py.File(path, "r+") as file:
        file.attrs["commitment"] = "0" * 64
    reseal(folder / "public", contents=False)
    with pytest.raises(DataError, match="attribute 'commitment': expected"):
        load(folder / "public")[0]


@pytest.mark.parametrize("change", [{"commitment": "0"}, {"annotate": "test"}, {"object_sha256": "x"}])
def test_a_sealed_manifest_is_of_its_form_or_refused(folder, change):
    manifest = read_manifest(folder / "public")
    write_manifest(folder / "public", replace(manifest, settings=replace(manifest.settings, **change)))
    with pytest.raises(DataError, match="is damaged or was edited"):
        read_manifest(folder / "public")
