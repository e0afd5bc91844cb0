"""SymsolDataset gives torch's DataLoader what `load` gives, in any order, process and share."""

import pickle
import subprocess
import sys

import numpy as np
import pytest
import symsol_source
import torch
from made_sets import make_set
from torch.utils.data import DataLoader

import symsol_annot
from symsol_annot.errors import DataError, SettingsError
from symsol_annot.sets.torch import ShuffledShards, SymsolDataset, padded_symmetry_sets
from symsol_annot.symsol.importing import import_symsol

IMAGES = 40  # in three shards

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:This DataLoader will create"),  # on a machine of one core
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make_set(tmp_path_factory.mktemp("torch"), train=IMAGES, test=5, annotate="all")


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    place = tmp_path_factory.mktemp("imported")
    files, _ = symsol_source.content(("tet", "tetX"))
    path = symsol_source.write_zip(place / "symsol.zip", files)
    return {made.folder.name: made.folder for made in import_symsol(path, place / "sets")}


def test_an_item_is_the_sample_as_tensors(folder):
    chw, hwc = (SymsolDataset(folder, layout=layout, segmentation=True) for layout in ("chw", "hwc"))
    for index, sample in enumerate(symsol_annot.load(folder, "train")):
        item = chw[index]
        assert np.array_equal(item["image"].numpy().transpose(1, 2, 0), sample.image)
        assert item["image"].is_contiguous()
        assert np.array_equal(hwc[index]["image"], sample.image)
        assert np.array_equal(item["rotation"], sample.rotation.astype(np.float32))
        assert np.array_equal(item["symmetry_mask"], sample.symmetry_mask)
        assert np.array_equal(item["segmentation"], sample.segmentation)
        assert (item["marking_pixels"], item["marking_visible"]) == (sample.marking_pixels, sample.marking_visible)
        assert np.array_equal(item["part_pixels"], sample.part_pixels)
        assert item["index"] == index
    assert np.array_equal(chw.symmetry_group, sample.symmetry_group.astype(np.float32))


def test_depth_is_in_items_where_it_is_asked_for(folder, tmp_path):
    deep = make_set(tmp_path, test=4, size=16, depth=True)
    batch = next(iter(DataLoader(SymsolDataset(deep, "test", depth=True), batch_size=4)))
    for depth, sample in zip(batch["depth"], symsol_annot.load(deep), strict=True):
        assert depth.dtype == torch.float32
        assert np.array_equal(depth, sample.depth)
        assert sample.depth.any()
    assert "depth" not in SymsolDataset(deep, "test")[0]
    with pytest.raises(SettingsError, match="has none; `symsol-annot render --depth` makes sets with it"):
        SymsolDataset(folder, depth=True)


def test_torchs_own_collate_stacks_items(folder):
    batch = next(iter(DataLoader(SymsolDataset(folder, dtype=torch.float64), batch_size=8)))
    assert {name: (tuple(values.shape), values.dtype) for name, values in batch.items()} == {
        "image": ((8, 3, 32, 32), torch.uint8),
        "rotation": ((8, 3, 3), torch.float64),
        "index": ((8,), torch.int64),
        "symmetry_mask": ((8, 12), torch.bool),
        "marking_pixels": ((8,), torch.float64),
        "marking_visible": ((8,), torch.bool),
        "part_pixels": ((8, 2), torch.float32),
    }


@pytest.mark.parametrize(("method", "has_sampler"), [("fork", False), ("spawn", True)])
def test_workers_read_every_image_once(folder, method, has_sampler):
    dataset = SymsolDataset(folder, transform=torch.bitwise_not)
    images = [sample.image for sample in symsol_annot.load(folder, "train")]
    dataset[7]  # used before the workers start
    order = {"sampler": ShuffledShards(dataset, seed=3)} if has_sampler else {"shuffle": True}
    loader = DataLoader(dataset, 7, num_workers=2, multiprocessing_context=method, timeout=120, **order)
    read = [pair for batch in loader for pair in zip(batch["index"].tolist(), batch["image"], strict=True)]
    assert sorted(index for index, _ in read) == list(range(IMAGES))
    assert [index for index, _ in read] != list(range(IMAGES))
    assert all(np.array_equal(255 - image.numpy().transpose(1, 2, 0), images[index]) for index, image in read)


def test_it_is_pickled_also_after_use(folder):
    dataset = SymsolDataset(folder, "test")
    expected = dataset[3]["image"]
    assert torch.equal(pickle.loads(pickle.dumps(dataset))[3]["image"], expected)


def test_a_slice_of_a_loaded_set_is_a_dataset(folder):
    dataset = SymsolDataset(symsol_annot.load(folder, "train")[10:30])
    assert len(dataset) == 20
    assert dataset[0]["index"] == 10
    assert sorted(ShuffledShards(dataset)) == list(range(20))


def test_ranks_share_an_epoch_and_epochs_differ(folder):
    dataset = SymsolDataset(folder)
    samplers = [ShuffledShards(dataset, seed=1, rank=rank, ranks=3) for rank in range(3)]
    assert sum(len(sampler) for sampler in samplers) == IMAGES
    epochs = []
    for epoch in range(2):
        for sampler in samplers:
            sampler.set_epoch(epoch)
        epochs.append([row for sampler in samplers for row in sampler])
        assert all(len(list(sampler)) == len(sampler) for sampler in samplers)
    assert sorted(epochs[0]) == sorted(epochs[1]) == list(range(IMAGES))
    assert epochs[0] != epochs[1]


def test_a_sampler_says_the_epoch_to_workers_that_stay(folder):
    dataset = SymsolDataset(folder)
    sampler = ShuffledShards(dataset)
    loader = DataLoader(dataset, 8, sampler=sampler, num_workers=1, persistent_workers=True, timeout=60)
    epochs = []
    for epoch in range(2):
        sampler.set_epoch(epoch)
        expected = symsol_annot.shuffled_order(dataset.samples, seed=0, epoch=epoch).tolist()
        epochs.append([index for batch in loader for index in batch["index"].tolist()])
        assert epochs[-1] == expected
    assert epochs[0] != epochs[1]


def test_padded_sets_are_the_samples_sets_and_then_their_own_rotation(folder):
    dataset = SymsolDataset(folder, dtype=torch.float64)
    batch = next(iter(DataLoader(dataset, IMAGES)))
    sets, sizes = padded_symmetry_sets(batch["rotation"], batch["symmetry_mask"], dataset.symmetry_group)
    samples = list(dataset.samples)
    assert sets.shape[1] == max(len(sample.symmetry_set) for sample in samples)
    assert len(set(sizes.tolist())) > 1
    for sample, padded, size in zip(samples, sets.numpy(), sizes.tolist(), strict=True):
        assert np.allclose(padded[:size], sample.symmetry_set, atol=1e-15)
        assert np.allclose(padded[size:], sample.rotation, atol=1e-15)


def test_an_imported_set_has_no_labels_but_its_own(imported):
    with_sets, without = (SymsolDataset(imported[name], "test") for name in ("tet", "tetX"))
    assert set(with_sets[0]) == {"image", "rotation", "index", "symmetry_mask"}
    assert set(without[0]) == {"image", "rotation", "index"}
    assert len(next(iter(DataLoader(without, 6)))["image"]) == 6
    with pytest.raises(SettingsError, match="was imported, and has none"):
        SymsolDataset(imported["tet"], segmentation=True)


def test_what_makes_no_dataset_is_said(folder, tmp_path):
    with pytest.raises(SettingsError, match="layout: expected one of chw, hwc, found 'nchw'"):
        SymsolDataset(folder, layout="nchw")
    with pytest.raises(DataError, match="holds no manifest"):
        SymsolDataset(tmp_path)
    with pytest.raises(SettingsError, match="expected 0 to 1, as there are 2 parts, found 2"):
        ShuffledShards(SymsolDataset(folder), rank=2, ranks=2)
    with pytest.raises(IndexError, match="out of range"):
        SymsolDataset(folder)[IMAGES]


def test_without_torch_one_line_says_what_to_install():
    code = "import sys; sys.modules['torch'] = None; import symsol_annot; import symsol_annot.sets.torch"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    last = done.stderr.strip().splitlines()[-1]
    assert last.endswith("symsol_annot.torch needs torch, which is not installed: `pip install 'symsol-annot[bench]'`")
    assert "During handling" not in done.stderr


def test_a_dataset_of_torch_says_what_it_is(tmp_path):
    folder = make_set(tmp_path, "tetX", test=2, size=16)
    shown = repr(SymsolDataset(folder, "test", segmentation=True))
    assert shown == f"<SymsolDataset of <tetX test: 2 images in {folder}>: 16x16, chw, torch.float32, segmentation>"
