"""Batch normalisation's statistics, taken from many images at once after each epoch."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from reference_models import network
from tiny_training import CPU, HYPOTHESES

from symsol_annot.bench.models.training import loop
from symsol_annot.bench.models.training.checkpoints import open_checkpoint
from symsol_annot.bench.models.training.loop import train
from symsol_annot.bench.models.training.statistics import retake_statistics

RECIPE = replace(
    HYPOTHESES,
    epochs=1,
    epochs_to_one=0,
    milestones=(),
    learning_rates=(1e-3,),
    validation_images=4,
    statistics_images=12,
)


def pictures_of(count):
    return torch.from_numpy(np.random.default_rng(0).integers(0, 256, (count, 16, 16, 3), dtype=np.uint8))


@pytest.mark.parametrize("is_training", [True, False])
def test_a_layers_statistics_become_those_of_all_images(is_training):
    stage = network().first_stage.train(is_training)
    layer, seen = stage.resnet.bn1, []
    layer.register_forward_pre_hook(lambda _, given: seen.append(given[0]))
    before = {name: tensor.clone() for name, tensor in stage.named_parameters()}
    retake_statistics(stage, pictures_of(24))
    (given,) = seen
    assert len(given) == 24
    torch.testing.assert_close(layer.running_mean, given.mean((0, 2, 3)))
    torch.testing.assert_close(layer.running_var, given.var((0, 2, 3)))
    assert (layer.momentum, stage.training, layer.training) == (0.1, is_training, is_training)
    assert all(torch.equal(tensor, before[name]) for name, tensor in stage.named_parameters())


def test_what_is_evaluated_and_kept_of_an_epoch_has_them(tmp_path, images, monkeypatch):
    """Of the epoch's own first images, turned as it turns them; and a training without them learns the same weights."""
    taken = []
    monkeypatch.setattr(
        loop, "retake_statistics", lambda stage, given: (taken.append(given), retake_statistics(stage, given))
    )
    recipe = replace(RECIPE, rolls=True)
    train(recipe, images, tmp_path / "retaken", CPU, name="retaken")
    train(replace(recipe, statistics_images=0), images, tmp_path / "running", CPU, name="running")
    (given,) = taken
    assert len(given) == 12
    retaken, running = (open_checkpoint(tmp_path / name).model for name in ("retaken", "running"))
    assert all(torch.equal(a, b) for a, b in zip(retaken.parameters(), running.parameters(), strict=True))
    layers = [model.first_stage.resnet.layer4[1].bn2 for model in (retaken, running)]
    assert not torch.allclose(layers[0].running_mean, layers[1].running_mean)
    retake_statistics(running.first_stage, given)
    torch.testing.assert_close(layers[0].running_mean, layers[1].running_mean)


def test_more_images_than_there_are_is_all_that_an_epoch_has(tmp_path, images, monkeypatch):
    taken = []
    monkeypatch.setattr(loop, "retake_statistics", lambda _, given: taken.append(len(given)))
    train(replace(RECIPE, statistics_images=1000), images, tmp_path / "all", CPU, name="all")
    batch, learnt = RECIPE.batch_size, len(images) - 4
    assert taken == [learnt // batch * batch]
