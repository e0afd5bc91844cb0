"""A set read by several threads and processes at once, and pickled."""

import multiprocessing
import operator
import pickle
import random
from concurrent.futures import ThreadPoolExecutor

import pytest
from processes import open_shards
from read_samples import TEST_IMAGES, assert_is, expected_samples, indices

from symsol_annot.sets import dataset as dataset_module
from symsol_annot.sets.dataset import load


@pytest.mark.parametrize("cap", [1, 2])
def test_threads_read_the_same_while_they_take_each_others_files_away(tetX_set, monkeypatch, cap):
    monkeypatch.setattr(dataset_module, "MAX_OPEN_SHARDS", cap)
    dataset, expected = load(tetX_set), expected_samples(tetX_set)

    def read_all(seed):
        order = list(range(TEST_IMAGES)) * 5
        random.Random(seed).shuffle(order)
        for index in order:
            assert_is(dataset[index], index, expected[index])
        return len(order)

    with ThreadPoolExecutor(6) as pool:
        assert list(pool.map(read_all, range(6))) == [5 * TEST_IMAGES] * 6
    dataset.close()
    assert open_shards(tetX_set) == 0


@pytest.mark.parametrize("is_used", [False, True])
def test_dataset_survives_pickling(tetX_set, is_used):
    dataset, expected = load(tetX_set)[8:], expected_samples(tetX_set)
    if is_used:
        assert dataset[0].index == 8
    copy = pickle.loads(pickle.dumps(dataset))
    assert indices(copy) == indices(dataset) == list(range(8, TEST_IMAGES))
    assert_is(copy[9], 17, expected[17])
    assert_is(dataset[9], 17, expected[17])


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_worker_processes_read_the_same_also_after_use_in_the_parent(tetX_set, method):
    dataset, expected = load(tetX_set), expected_samples(tetX_set)
    for index in (0, 20, 39):
        assert_is(dataset[index], index, expected[index])
    with multiprocessing.get_context(method).Pool(2) as pool:
        reading = pool.starmap_async(operator.getitem, [(dataset, index) for index in range(TEST_IMAGES)], chunksize=1)
        for index in range(TEST_IMAGES):  # while the workers read
            assert_is(dataset[index], index, expected[index])
        for index, sample in enumerate(reading.get(timeout=120)):
            assert_is(sample, index, expected[index])
    assert_is(dataset[39], 39, expected[39])


def put_every_third(dataset, queue):
    for index in range(0, TEST_IMAGES, 3):
        queue.put(dataset[index])
    queue.put(open_shards(dataset.folder))


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_files_that_are_open_at_a_fork_are_read_by_parent_and_children_at_once(tetX_set):
    dataset, expected = load(tetX_set), expected_samples(tetX_set)
    assert indices(dataset) == list(range(TEST_IMAGES))
    context = multiprocessing.get_context("fork")  # what it hands over is not pickled, but the parent's very object
    queues = [context.SimpleQueue() for _ in range(3)]
    children = [context.Process(target=put_every_third, args=(dataset, queue), daemon=True) for queue in queues]
    for child in children:
        child.start()
    for queue in queues:
        for index in range(0, TEST_IMAGES, 3):
            assert_is(queue.get(), index, expected[index])
            assert_is(dataset[-index - 1], TEST_IMAGES - index - 1, expected[-index - 1])
        assert queue.get() == 3
    for child in children:
        child.join(timeout=60)
        assert child.exitcode == 0
