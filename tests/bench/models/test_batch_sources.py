"""Batches of a training: each image once per epoch, from memory or from workers."""

import numpy as np
import torch

from symsol_annot.bench.models.batches import decode_images
from symsol_annot.bench.models.training import batch_sources
from symsol_annot.bench.models.training.batch_sources import InMemory, Streamed, open_batches
from symsol_annot.bench.models.training.split_reader import SplitReader


def test_an_epoch_has_each_image_once_in_an_order_of_its_own(images):
    held = InMemory(decode_images(images), 5, 3, torch.device("cpu"), on_device=True)
    epochs = [torch.cat([batch.R_gt for batch in held.batches(epoch)]) for epoch in (0, 1, 0)]
    assert all(len(torch.unique(R, dim=0)) == len(R) == 20 for R in epochs)
    assert torch.equal(epochs[0], epochs[2])
    assert not torch.equal(epochs[0], epochs[1])
    for batch in held.batches(0):
        for picture, R in zip(batch.images, batch.R_gt, strict=True):
            (row,) = [s for s in images if np.allclose(s.rotation, R, atol=1e-6)]
            assert np.array_equal(row.image, picture)


def test_images_that_are_fewer_than_a_batch_are_left_out_of_an_epoch(images):
    held = InMemory(decode_images(images), 8, 0, torch.device("cpu"), on_device=True)
    assert [len(batch.R_gt) for batch in held.batches(0)] == [8, 8]
    assert held.batches_per_epoch() == 2
    small = InMemory(decode_images(images[:6]), 8, 0, torch.device("cpu"), on_device=True)
    assert [len(batch.R_gt) for batch in small.batches(0)] == [6]


def test_workers_read_the_same_images_where_memory_is_too_small(images, monkeypatch):
    monkeypatch.setattr(batch_sources, "free_bytes", lambda _: 1000)
    monkeypatch.setattr(batch_sources, "cores", lambda: 2)
    streamed = open_batches(images, 5, 0, torch.device("cpu"))
    assert isinstance(streamed, Streamed)
    batches = list(streamed.batches(0))
    assert len(batches) == streamed.batches_per_epoch() == 4
    R_gt = torch.cat([batch.R_gt for batch in batches])
    assert len(torch.unique(R_gt, dim=0)) == 20
    assert batches[0].images.dtype == torch.uint8


def test_as_many_workers_read_as_are_asked_for(images, monkeypatch):
    monkeypatch.setattr(batch_sources, "free_bytes", lambda _: 1000)
    monkeypatch.setattr(batch_sources, "cores", lambda: 64)
    asked = []
    monkeypatch.setattr(batch_sources, "Streamed", lambda *given: asked.append(given[4]))
    for workers in (None, 3, 20):
        open_batches(images, 5, 0, torch.device("cpu"), reader=SplitReader(8, workers))
    assert asked == [8, 3, 20]
