"""What a plan decides: each image's label, how a split is divided into shards, and which settings make no set."""

from dataclasses import replace

import numpy as np
import pytest
from four_shards import small_plan
from hypothesis import given, settings
from hypothesis import strategies as st
from made_sets import make_plan
from scipy.stats import kstest

from symsol_annot.errors import SettingsError
from symsol_annot.rendering.camera import Camera
from symsol_annot.sets.plan import label_rotation

# Labels


@pytest.mark.parametrize(
    "other", [(1, "tetX", "test", 3), (0, "tet", "test", 3), (0, "tetX", "train", 3), (0, "tetX", "test", 4)]
)
def test_label_differs_with_seed_object_split_and_index(other):
    assert np.abs(label_rotation(*other) - label_rotation(0, "tetX", "test", 3)).max() > 1e-3


def test_label_is_a_rotation_that_does_not_depend_on_earlier_calls():
    first = label_rotation(5, "cylO", "train", 9)
    np.random.seed(1)  # noqa: NPY002 - nobody's global state may matter
    label_rotation(5, "cylO", "train", 10)
    np.testing.assert_array_equal(label_rotation(5, "cylO", "train", 9), first)
    np.testing.assert_allclose(first.T @ first, np.eye(3), atol=1e-14)
    assert np.linalg.det(first) == pytest.approx(1)


def test_known_labels():
    # A change here changes every published set.
    expected = {
        (0, "tetX", "test", 0): [
            [0.32257350215929326, 0.22963652487035432, -0.9182665202163017],
            [0.5593581042826, -0.8288559838162017, -0.01078282270336658],
            [-0.7635868299532572, -0.5101615670917826, -0.3958160287108041],
        ],
        (2026, "cylO", "train", 44999): [
            [0.9305706711336112, -0.3598864368077822, -0.0672307863090898],
            [0.1356611344383547, 0.5095168772166087, -0.8496991281826376],
            [0.3400504118933529, 0.7815844832346877, 0.5229640646716822],
        ],
    }
    for arguments, R in expected.items():
        np.testing.assert_allclose(label_rotation(*arguments), R, rtol=0, atol=1e-14)


def test_labels_are_uniform_on_so3():
    labels = np.stack([label_rotation(0, "tetX", "test", index) for index in range(4000)])
    from_one_to_the_next = np.swapaxes(labels[:-1], 1, 2) @ labels[1:]
    for R in (labels, from_one_to_the_next):
        angle = np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1) / 2, -1, 1))
        assert kstest(angle, lambda t: (t - np.sin(t)) / np.pi).pvalue > 0.01  # the Haar measure's law of the angle
        for image in (R[:, :, 0], R[:, :, 2], R @ np.array([0.6, 0.0, 0.8])):  # a point's images: uniform on the sphere
            for coordinate in image.T:
                assert kstest(coordinate, lambda x: (x + 1) / 2).pvalue > 0.001  # Archimedes
            longitude = np.arctan2(image[:, 1], image[:, 0])
            assert kstest(longitude, lambda t: (t + np.pi) / (2 * np.pi)).pvalue > 0.001


# Shards


def shard_names(split, count):
    return [f"{split}-{number:05d}-of-{count:05d}.h5" for number in range(count)]


def division(**counts):
    return [(entry.file, entry.images) for entry in make_plan("tet", **counts).manifest().shards]


def test_published_test_split_is_ten_shards_of_500():
    assert division(test=5000, size=224) == [(name, 500) for name in shard_names("test", 10)]


def test_small_split_is_still_divided_among_workers():
    assert division(test=64, size=224) == [(name, 16) for name in shard_names("test", 4)]


def test_train_comes_before_test():
    assert [name for name, _ in division(train=20, test=1)] == [*shard_names("train", 2), *shard_names("test", 1)]


def test_large_images_make_smaller_shards():
    bytes_each = 2048 * 2048 * 4  # RGB and segmentation; a shard is built in memory
    sizes = [images for _, images in division(test=5000, size=2048)]
    assert max(sizes) < 500
    assert max(sizes) * bytes_each <= 2**27
    assert sum(sizes) == 5000


@settings(deadline=None)
@given(st.integers(0, 60_000), st.integers(1, 60_000), st.integers(16, 2048))
def test_shards_cover_every_image_of_a_split_once(train, test, size):
    plan = replace(small_plan(), images={"train": train, "test": test}, camera=Camera.filling(size))
    manifest = plan.manifest()
    for split, images in plan.images.items():
        entries = manifest.of_split(split)
        assert [entry.file for entry in entries] == shard_names(split, len(entries))
        ends = [entry.first_index + entry.images for entry in entries]
        assert [entry.first_index for entry in entries] == [0, *ends][:-1]
        assert ends[-1:] == ([images] if images else [])
        assert all(0 < entry.images <= 500 for entry in entries)


# Settings


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"images": {"test": -1}}, "images: .*-1"),
        ({"images": {"train": 10, "test": -1}}, "images: .*-1"),
        ({"images": {"train": 0, "test": 0}}, "not all 0"),
        ({"images": {}}, "not all 0"),
        ({"images": {"test": 1, "validation": 1}}, "splits: expected train, test, found .*validation"),
        ({"annotate": "train"}, "annotate: expected one of all, test, none, found 'train'"),
        ({"annotate": ""}, "annotate: .*''"),
        ({"seed": -1}, f"seed: expected 0 to {2**128 - 1}, found -1"),
        ({"seed": 2**128}, f"found {2**128}"),
    ],
)
def test_settings_that_make_no_set_are_refused(change, words):
    with pytest.raises(SettingsError, match=words):
        replace(small_plan(), **change)
