"""Images that a recipe reduces are read once, and are the same from a cache."""

from dataclasses import replace

import pytest
import torch
from changed_checkpoints import same_tensors
from made_sets import make_set
from tiny_training import CPU, HYPOTHESES

from symsol_annot.bench.models.batches import decode_images
from symsol_annot.bench.models.training import loop, split_reader
from symsol_annot.bench.models.training.loop import train
from symsol_annot.bench.models.training.split_reader import SplitReader
from symsol_annot.sets.dataset import load
from symsol_annot.system.cache import Cache


@pytest.fixture
def decoded(monkeypatch):
    """How many images each call decoded."""
    told = []

    def counting(dataset, *rest):
        told.append(len(dataset))
        return decode_images(dataset, *rest)

    monkeypatch.setattr(split_reader, "decode_images", counting)
    return told


def test_reduced_images_are_decoded_once_and_are_the_same_from_the_cache(images, tmp_path, decoded):
    reader = SplitReader(8, cache=Cache(tmp_path))
    for part in (images, images[:15], images[15:], images[::2]):
        first, again, plain = reader.read(part), reader.read(part), decode_images(part, 8)
        assert again.images.shape == (len(part), 8, 8, 3)
        for one in (first, again):
            assert torch.equal(one.images, plain.images)
            assert torch.equal(one.R_gt, plain.R_gt)
    assert decoded == [20, 15, 5, 10]
    again.images.add_(1)  # its own memory, that may be written


def test_other_images_and_sizes_and_ways_of_reducing_have_files_of_their_own(images, tmp_path, decoded, monkeypatch):
    cache = Cache(tmp_path / "cache")
    SplitReader(8, cache=cache).read(images)
    SplitReader(9, cache=cache).read(images)
    folder = make_set(tmp_path / "data", "tetX", train=20, test=2, size=16, seed=9)
    other = load(folder, "train")
    assert torch.equal(SplitReader(8, cache=cache).read(other).images, decode_images(other, 8).images)
    monkeypatch.setattr(split_reader, "_WAY_OF_REDUCING", 2)
    SplitReader(8, cache=cache).read(images)
    assert decoded == [20] * 4


def test_a_damaged_file_and_one_of_another_length_are_made_again(images, tmp_path, decoded):
    reader = SplitReader(8, cache=Cache(tmp_path))
    reader.read(images)
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:-1] + b"?")
    reader.read(images)
    Cache(tmp_path).put(path.stem, b"short")
    assert torch.equal(reader.read(images).images, decode_images(images, 8).images)
    reader.read(images)
    assert decoded == [20] * 3


def test_images_as_they_are_and_a_cache_that_cannot_be_written_keep_nothing(images, tmp_path, decoded):
    for size in (0, 16):
        SplitReader(size, cache=Cache(tmp_path / "cache")).read(images)
    (tmp_path / "file").write_text("")
    SplitReader(8, cache=Cache(tmp_path / "file")).read(images)
    assert decoded == [20] * 3
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_threads_are_as_many_as_asked_for(images, monkeypatch):
    from symsol_annot.bench.models import batches

    pool, asked = batches.ThreadPoolExecutor, []
    monkeypatch.setattr(batches, "ThreadPoolExecutor", lambda count: asked.append(count) or pool(count))
    monkeypatch.setattr(batches, "cores", lambda: 5)
    three, default = (SplitReader(8, workers).read(images).images for workers in (3, None))
    assert asked == [3, 5]
    assert torch.equal(three, default)


def test_a_training_on_kept_images_has_the_same_weights(images, tmp_path, decoded, monkeypatch):
    monkeypatch.setattr(loop, "plot_curve", lambda *_: None)
    recipe, options = replace(HYPOTHESES, input_size=8), replace(CPU, epochs=1, cache=Cache(tmp_path / "cache"))
    for name in ("first", "second"):
        train(recipe, images, tmp_path / name, options)
    assert decoded == [16, 4]
    train(recipe, images, tmp_path / "without", replace(options, cache=None))
    for name in ("second", "without"):
        assert same_tensors(tmp_path / "first" / "weights.safetensors", tmp_path / name / "weights.safetensors")
