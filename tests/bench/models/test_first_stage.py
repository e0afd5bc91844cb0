"""The first stage: what images it takes, and what freezing leaves alone."""

import numpy as np
import pytest
import torch
from reference_models import (
    changed,
    classifier,
    loss_of_classifier,
    network,
    pictures,
    rotations,
    snapshot,
    with_statistics,
)

from symsol_annot.bench.models.networks.first_stage import FirstStage
from symsol_annot.bench.models.weights.state_dicts import write_weights
from symsol_annot.errors import ModelError, WeightsError


@pytest.mark.parametrize(
    "images",
    [
        torch.zeros(2, 8, 8, 3),
        torch.zeros(2, 3, 8, 8, dtype=torch.uint8),
        torch.zeros(8, 8, 3, dtype=torch.uint8),
        torch.zeros(2, 8, 8, 4, dtype=torch.uint8),
    ],
)
def test_images_that_are_not_as_a_set_stores_them_are_refused(images):
    for ask in (network(), lambda x: classifier()(x, rotations(2))):
        with pytest.raises(ModelError, match=r"\(B, H, W, 3\) uint8") as caught:
            ask(images)
        assert str(tuple(images.shape)) in str(caught.value)


def test_a_classifier_takes_the_first_stage_of_a_hypothesis_network(tmp_path):
    trained = with_statistics(network(hypotheses=7, seed=3)).float()
    write_weights(tmp_path / "network.safetensors", trained)
    torch.save(trained.state_dict(), tmp_path / "network.pth")
    for name in ("network.safetensors", "network.pth"):
        model = classifier().eval()
        second_stage = snapshot(model.second_stage)
        model.first_stage.load_hypothesis_network(tmp_path / name)
        assert torch.equal(model.first_stage(pictures()), trained.first_stage(pictures()))
        assert changed(model.second_stage, second_stage) == set()


@pytest.mark.parametrize("kind", ["classifier", "backbone", "first stage", "headless", "cut"])
def test_the_first_stage_of_nothing_else_is_taken(kind, tmp_path):
    trained = network()
    whole = trained.state_dict()
    torch.save(
        {
            "classifier": classifier().state_dict(),
            "backbone": trained.first_stage.resnet.state_dict(),
            "first stage": trained.first_stage.state_dict(),
            "headless": {name: tensor for name, tensor in whole.items() if name.startswith("first_stage")},
            "cut": {name: tensor for name, tensor in whole.items() if name != "first_stage.embedding.bias"},
        }[kind],
        tmp_path / "other.pth",
    )
    model = classifier(seed=5)
    before = snapshot(model)
    with pytest.raises(WeightsError, match=r"other\.pth.*HypothesisNetwork"):
        model.first_stage.load_hypothesis_network(tmp_path / "other.pth")
    assert changed(model, before) == set()


def step(model, images, R_gt):
    """One step of training, in training mode, with an optimiser of all parameters and of great zeal."""
    model.train()
    optimizer = torch.optim.Adam(model.parameters(), lr=0.1)
    loss_of_classifier(model, images, R_gt).backward()
    optimizer.step()


def test_a_frozen_first_stage_stays_to_the_bit_while_the_second_learns():
    model = classifier()
    model.first_stage.freeze()
    before = snapshot(model)
    for _ in range(2):
        step(model, pictures(), rotations(3))
    moved = changed(model, before)
    assert moved == {
        f"second_stage.{layer}.{part}" for layer in ("entry", "hidden", "logit") for part in ("weight", "bias")
    }


def test_freezing_takes_effect_at_once_in_the_middle_of_training():
    model = network().train()
    model.first_stage.freeze()
    before = snapshot(model.first_stage)
    model(pictures())
    assert changed(model.first_stage, before) == set()


def test_a_first_stage_that_is_frozen_after_it_learned_keeps_no_gradients():
    model = classifier()
    loss_of_classifier(model, pictures(), rotations(3)).backward()
    model.first_stage.freeze()
    before = snapshot(model.first_stage)
    step(model, pictures(), rotations(3))
    assert changed(model.first_stage, before) == set()


def test_a_frozen_first_stage_computes_the_same_in_every_mode_and_batch():
    model = with_statistics(classifier()).train()
    images = pictures()
    model.first_stage.freeze()
    frozen = model.train().first_stage(images)
    assert torch.equal(frozen, model.eval().first_stage(images))
    np.testing.assert_allclose(model.train().first_stage(images[:1]), frozen[:1], atol=1e-12)
    assert not frozen.requires_grad
    assert model.second_stage.training


def test_an_unfrozen_first_stage_learns_again_statistics_included():
    model = classifier()
    model.first_stage.freeze()
    step(model, pictures(), rotations(3))
    model.first_stage.unfreeze()
    before = snapshot(model.first_stage)
    step(model, pictures(), rotations(3))
    assert changed(model.first_stage, before) == set(before)


@pytest.mark.parametrize("mode", [True, False])
def test_unfreezing_puts_it_in_the_mode_of_its_model(mode):
    model = classifier()
    model.first_stage.freeze()
    model.train(mode)
    model.first_stage.unfreeze()
    assert {layer.training for layer in model.modules()} == {mode}


def test_freezing_is_of_the_first_stage_that_both_models_have():
    assert type(network().first_stage) is type(classifier().first_stage) is FirstStage
    model = network()
    model.first_stage.freeze()
    assert [name for name, parameter in model.named_parameters() if parameter.requires_grad] == [
        "output.weight",
        "output.bias",
    ]
