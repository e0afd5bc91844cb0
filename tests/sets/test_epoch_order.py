"""The order of an epoch: every image once, each shard opened once, whoever shares the reading."""

import multiprocessing
import pickle
import threading
from collections import Counter, OrderedDict
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from made_sets import make_plan, make_set
from order_readers import OPENED, Part, RecordedFile, collate, read_part, record_opens
from processes import open_shards
from scipy.stats import chisquare
from torch.utils.data import DataLoader

from symsol_annot import shuffled_order
from symsol_annot.errors import SettingsError
from symsol_annot.sets import dataset as dataset_module
from symsol_annot.sets import plan as plan_module
from symsol_annot.sets.dataset import MAX_OPEN_SHARDS, Dataset, load
from symsol_annot.sets.manifest import Manifest, ShardEntry
from symsol_annot.sets.shard import reader as shards

IMAGES, PER_SHARD = 68, 3
SHARDS = 23

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:This DataLoader will create"),  # on a machine of one core
]


@cache
def set_settings():
    return make_plan().set_settings


def planned(sizes):
    """A split of shards of these many images, none of which exists: reading one would fail."""
    first = np.cumsum([0, *sizes])
    entries = (ShardEntry(f"test-{k}.h5", "test", int(first[k]), size) for k, size in enumerate(sizes))
    return Dataset(Path("/nowhere"), "test", Manifest(set_settings(), tuple(entries)))


@st.composite
def slices_of_planned(draw):
    """A dataset, or a slice of one, and the shard of each of its rows."""
    sizes = draw(st.lists(st.integers(1, 6), min_size=1, max_size=40))
    bounds = st.none() | st.integers(-sum(sizes) - 2, sum(sizes) + 2)
    chosen = draw(st.just(slice(None)) | st.builds(slice, bounds, bounds, st.sampled_from([None, 1, 2, 7, -1, -3])))
    return planned(sizes)[chosen], [k for k, size in enumerate(sizes) for _ in range(size)][chosen]


def opens(shards, kept=MAX_OPEN_SHARDS):
    """How often shards are opened that are read in this order, if those used last are kept open."""
    count, is_open = 0, OrderedDict()
    for shard in shards:
        count += shard not in is_open
        is_open.pop(shard, None)
        is_open[shard] = True
        if len(is_open) > kept:
            is_open.popitem(last=False)
    return count


def parts_of(dataset, parts, seed=0, epoch=0):
    return [shuffled_order(dataset, seed, epoch, part, parts) for part in range(parts)]


many_parts = st.integers(1, 12) | st.integers(13, 300)
seeds = st.integers(0, 2**70)


@settings(deadline=None)
@given(slices_of_planned(), seeds, seeds, many_parts)
def test_parts_hold_every_row_once_and_differ_by_at_most_one_image(sliced, seed, epoch, parts):
    dataset, _ = sliced
    orders = parts_of(dataset, parts, seed, epoch)
    assert sorted(np.concatenate(orders)) == list(range(len(dataset)))
    assert {len(order) for order in orders} <= {len(dataset) // parts, -(-len(dataset) // parts)}
    assert {order.dtype for order in orders} == {np.dtype(np.int64)}


@settings(deadline=None)
@given(slices_of_planned(), seeds, many_parts)
def test_reader_opens_each_of_its_shards_once(sliced, seed, parts):
    dataset, shards = sliced
    for order in parts_of(dataset, parts, seed):
        read = [shards[row] for row in order]
        assert opens(read) == len(set(read))


@settings(deadline=None)
@given(slices_of_planned(), seeds, many_parts)
def test_readers_share_a_shard_only_where_it_is_cut(sliced, seed, parts):
    dataset, shards = sliced
    there = [part for part in ({shards[row] for row in order} for order in parts_of(dataset, parts, seed)) if part]
    assert sum(map(len, there)) <= len(set(shards)) + max(0, len(there) - 1)
    assert all(len(one & next_one) <= 1 for one, next_one in pairwise(there))


@settings(deadline=None)
@given(slices_of_planned(), seeds, st.integers(1, 6), st.integers(1, 6))
def test_workers_of_a_rank_read_what_the_rank_reads_alone(sliced, seed, ranks, workers):
    dataset, _ = sliced
    by_workers = parts_of(dataset, ranks * workers, seed)
    for rank, alone in enumerate(parts_of(dataset, ranks, seed)):
        assert sorted(np.concatenate(by_workers[rank * workers :][:workers])) == sorted(alone)


@settings(deadline=None)
@given(slices_of_planned(), seeds, many_parts)
def test_order_follows_from_its_arguments_and_from_nothing_that_was_asked_before(sliced, seed, parts):
    dataset, _ = sliced
    orders = parts_of(dataset, parts, seed)
    copy = pickle.loads(pickle.dumps(dataset))
    for part in reversed(range(parts)):
        np.testing.assert_array_equal(shuffled_order(copy, seed, part=part, parts=parts), orders[part])


def test_numpy_integers_do_as_arguments():
    dataset = planned([5] * 20)
    seed, epoch, part, parts = np.uint8([7, 2, 1, 3])
    np.testing.assert_array_equal(shuffled_order(dataset, seed, epoch, part, parts), parts_of(dataset, 3, 7, 2)[1])


@settings(deadline=None)
@given(slices_of_planned())
def test_shard_numbers_are_those_of_the_rows(sliced):
    dataset, shards = sliced
    assert dataset.shard_numbers().tolist() == shards
    assert dataset.shard_numbers().dtype == np.int64


def test_another_seed_or_epoch_gives_another_order():
    dataset = planned([5] * 20)
    orders = {shuffled_order(dataset, seed, epoch).tobytes() for seed in range(20) for epoch in range(20)}
    assert len(orders) == 400


def test_order_is_the_same_on_every_machine_and_in_every_version():
    dataset = planned([3] * 12)
    assert shuffled_order(dataset[::4], seed=0).tolist() == [3, 6, 2, 4, 0, 8, 1, 5, 7]
    assert shuffled_order(dataset[::-2], seed=1, epoch=2, part=1, parts=2).tolist() == [6, 9, 0, 5, 1, 10, 11, 7, 8]


def is_uniform(counts, kinds):
    """Whether the counts are what chance makes of as many kinds, all as likely, but for once in 10,000."""
    return chisquare([*counts.values(), *[0] * (kinds - len(counts))]).pvalue > 1e-4


def test_every_order_within_a_window_is_as_likely_as_any_other():
    dataset = planned([2, 1, 1])
    counts = Counter(tuple(shuffled_order(dataset, 0, epoch)) for epoch in range(6000))
    assert is_uniform(counts, 24)


def test_every_order_of_the_images_before_a_cut_is_as_likely_as_any_other():
    dataset = planned([4])
    for part in range(2):
        counts = Counter(tuple(shuffled_order(dataset, 0, epoch, part, 2)) for epoch in range(1200))
        assert is_uniform(counts, 12)


def test_every_shard_is_as_likely_to_come_first_as_any_other():
    dataset = planned([1] * 24)
    assert is_uniform(Counter(shuffled_order(dataset, 0, epoch)[0] for epoch in range(6000)), 24)


def test_two_shards_share_a_window_in_some_epochs_and_in_others_not():
    dataset, epochs = planned([1] * 24), 3000  # 3 windows of 8
    window = [np.argsort(shuffled_order(dataset, 0, epoch))[:2] // MAX_OPEN_SHARDS for epoch in range(epochs)]
    assert sum(a == b for a, b in window) / epochs == pytest.approx(7 / 23, abs=0.03)


def test_neighbours_are_of_one_shard_in_one_of_eight_pairs():
    dataset = planned([500] * 96)
    shards = dataset.shard_numbers()[shuffled_order(dataset, seed=0)]
    assert np.mean(shards[1:] == shards[:-1]) == pytest.approx(1 / 8, abs=0.005)


@pytest.mark.parametrize("count", range(MAX_OPEN_SHARDS + 1, 4 * MAX_OPEN_SHARDS))
def test_no_window_is_left_with_one_or_two_shards(count):
    for dataset, parts in ((planned([40] * count), 1), (planned([40] * (2 * count - 1)), 2)):
        for order in parts_of(dataset, parts):
            shards = dataset.shard_numbers()[order]
            assert all(len(set(shards[start : start + 20])) > 2 for start in range(len(order) - 20))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"seed": -1}, "seed: expected an integer of 0 or more, found -1"),
        ({"seed": 0.5}, "seed: expected an integer of 0 or more, found 0.5"),
        ({"seed": None}, "seed: expected an integer of 0 or more, found None"),
        ({"seed": 0, "epoch": -1}, "epoch: expected an integer of 0 or more, found -1"),
        ({"seed": 0, "part": -1, "parts": 2}, "part: expected an integer of 0 or more, found -1"),
        ({"seed": 0, "parts": 0}, "parts: expected an integer of 1 or more, found 0"),
        ({"seed": 0, "part": 2, "parts": 2}, "part: expected 0 to 1, as there are 2 parts, found 2"),
        ({"seed": 0, "part": 1}, "part: expected 0 to 0, as there are 1 parts, found 1"),
    ],
)
def test_argument_out_of_its_range_is_an_error_that_says_the_range(arguments, message):
    with pytest.raises(SettingsError, match=f"^{message}$"):
        shuffled_order(planned([3]), **arguments)


@pytest.fixture(scope="module")
def many_shards(tmp_path_factory):
    """A set of more shards than are kept open; not to be written to."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan_module, "MAX_IMAGES_PER_SHARD", PER_SHARD)
        return make_set(tmp_path_factory.mktemp("many"), "tet", test=IMAGES, size=16)


@pytest.fixture
def opened(monkeypatch):
    """The names of the shards that this process opens from here on: for their labels, and for their images."""
    labels, describe = [], shards._DESCRIBER.describe
    monkeypatch.setattr(shards._DESCRIBER, "describe", lambda path: labels.append(path.name) or describe(path))
    for module in (shards, dataset_module):
        monkeypatch.setattr(module, "ByteFile", RecordedFile)
    OPENED.clear()
    return labels, OPENED


def has_no_twice(names):
    return len(names) == len(set(names))


@pytest.mark.parametrize("parts", [1, 2, 5])
def test_reader_of_files_opens_each_of_its_shards_once(many_shards, opened, parts):
    labels, files = opened
    read = []
    for part in range(parts):
        with load(many_shards)[::-1] as dataset:
            order = shuffled_order(dataset, seed=0, part=part, parts=parts)
            assert (labels, files) == ([], [])
            read += [dataset[row].index for row in order]
        assert has_no_twice(files)
        assert labels == files
        labels.clear(), files.clear()
    assert sorted(read) == list(range(IMAGES))


def test_reader_in_an_order_without_windows_opens_shards_again(many_shards, opened):
    assert len(list(many_shards.glob("*.h5"))) == SHARDS > 2 * MAX_OPEN_SHARDS
    with load(many_shards) as dataset:
        for row in np.random.default_rng(0).permutation(IMAGES):
            assert dataset[row].index == row
    assert len(opened[1]) > 1.5 * SHARDS


def loader_of(dataset, method, **options):
    """A DataLoader of two workers which note what they open; one that waits for a minute is an error."""
    return DataLoader(
        dataset,
        batch_size=8,
        num_workers=2,
        collate_fn=collate,
        worker_init_fn=record_opens,
        multiprocessing_context=method,
        timeout=60,
        **options,
    )


def assert_are_the_samples(batch, dataset):
    for name in ("image", "rotation", "symmetry_mask"):
        expected = np.stack([getattr(dataset[index], name) for index in batch["index"].tolist()])
        assert batch[name].numpy().dtype == expected.dtype
        np.testing.assert_array_equal(batch[name].numpy(), expected)


def opened_by_worker(batches):
    """What each worker has opened when it makes its last batch."""
    return {batch["worker"]: batch["opened"] for batch in batches}


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_torch_workers_read_the_order_and_each_opens_a_shard_once(many_shards, method):
    dataset = load(many_shards)
    order = shuffled_order(dataset, seed=0)
    batches = list(loader_of(dataset, method, sampler=order))
    assert open_shards(many_shards) == 0  # so there was none that a forked worker could share
    assert torch.cat([batch["index"] for batch in batches]).tolist() == order.tolist()
    for batch in batches:
        assert_are_the_samples(batch, dataset)
    opened = opened_by_worker(batches)
    assert set(opened) == {0, 1}
    assert all(map(has_no_twice, opened.values()))


@pytest.mark.parametrize(("method", "ranks"), [("fork", 1), ("fork", 2), ("spawn", 1)])
def test_torch_workers_with_parts_of_their_own_read_every_image_once_and_share_shards_at_cuts(
    many_shards, method, ranks
):
    dataset, indices, opened = load(many_shards), [], []
    for rank in range(ranks):
        batches = list(loader_of(Part(dataset, 0, rank, ranks), method))
        assert open_shards(many_shards) == 0
        indices += torch.cat([batch["index"] for batch in batches]).tolist()
        opened += [names for _, names in sorted(opened_by_worker(batches).items())]
    assert sorted(indices) == list(range(IMAGES))
    assert len(opened) == 2 * ranks
    assert all(map(has_no_twice, opened))
    assert all(len(set(one) & set(next_one)) <= 1 for one, next_one in pairwise(opened))
    assert sum(map(len, opened)) <= SHARDS + len(opened) - 1


def test_processes_of_a_pool_find_the_same_order_and_read_every_image_once(many_shards):
    parts = 4
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        reading = pool.starmap_async(read_part, [(many_shards, part, parts) for part in range(parts)], chunksize=1)
        read = reading.get(timeout=60)
    for (order, indices, opened), here in zip(read, parts_of(load(many_shards), parts, 3, 1), strict=True):
        np.testing.assert_array_equal(order, here)
        assert indices == here.tolist()
        assert has_no_twice(opened)
    assert sorted(index for _, indices, _ in read for index in indices) == list(range(IMAGES))


def test_workers_that_are_forked_while_a_thread_reads_do_not_wait_for_it(many_shards):
    is_done = threading.Event()

    def read_again_and_again():
        while not is_done.is_set():
            with load(many_shards) as dataset:
                assert sum(1 for _ in dataset) == IMAGES

    thread = threading.Thread(target=read_again_and_again)
    thread.start()
    try:
        for _ in range(5):
            assert sum(len(batch["index"]) for batch in loader_of(Part(load(many_shards), 0), "fork")) == IMAGES
    finally:
        is_done.set()
        thread.join()
