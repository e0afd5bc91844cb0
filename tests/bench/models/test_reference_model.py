"""What both reference models have: how they begin, that they learn, and their precision."""

import math

import numpy as np
import pytest
import torch
from reference_models import (
    changed,
    classifier,
    loss_of_classifier,
    loss_of_network,
    network,
    pictures,
    rotations,
    snapshot,
)

from symsol_annot.errors import SettingsError
from symsol_annot.rotations.so3 import rotation_deviation


def test_an_image_keeps_its_place_in_a_batch():
    model = network().eval()
    images = pictures()
    alone = torch.cat([model(image[None]) for image in images])
    np.testing.assert_allclose(model(images).detach(), alone.detach(), atol=1e-5)
    assert (alone[0] - alone[1]).abs().max() > 1e-3


@pytest.mark.parametrize("build", [network, classifier])
def test_a_model_is_drawn_from_its_rng_alone(build):
    torch.manual_seed(123)
    before = torch.get_rng_state()
    first = snapshot(build(seed=1))
    assert torch.equal(before, torch.get_rng_state())
    torch.manual_seed(5)
    assert changed(build(seed=1), first) == set()
    drawn = {
        name
        for name, tensor in first.items()
        if tensor.is_floating_point() and not ((tensor == 0) | (tensor == 1)).all()
    }
    assert changed(build(seed=2), first) == drawn
    assert len(drawn) == 20 + (4 if build is network else 8)  # convolutions; layers with a bias


def test_weights_begin_as_initialise_says():
    model = classifier()
    for name, weight in model.named_parameters():
        if weight.ndim == 4:
            expected = math.sqrt(2 / (weight.shape[0] * weight.shape[2] * weight.shape[3]))
            assert float(weight.detach().std()) == pytest.approx(expected, rel=0.05), name
            assert weight.abs().max() > 3 * expected  # normal, not uniform
    for layer, inputs in (
        (model.first_stage.embedding, 512),
        (model.second_stage.entry, 256 + 54),
        (model.second_stage.hidden, 256),
        (model.second_stage.logit, 256),
        (network().output, 256),
    ):
        bound = 1 / math.sqrt(inputs)
        assert 0.95 * bound < layer.weight.abs().max() <= bound
        assert layer.bias.abs().max() <= bound
        assert layer.bias.abs().max() > 0
        assert abs(layer.weight.mean()) < 0.1 * bound


def test_a_model_of_no_hypotheses_or_of_negative_frequencies_is_refused():
    for hypotheses in (0, -3):
        with pytest.raises(SettingsError, match=str(hypotheses)):
            network(hypotheses)
    with pytest.raises(SettingsError, match="-1"):
        classifier(-1)


@pytest.mark.parametrize(("build", "loss_of"), [(network, loss_of_network), (classifier, loss_of_classifier)])
def test_a_model_learns_a_few_images_with_all_its_parameters(build, loss_of):
    model, images, R_gt = build(), pictures(3), rotations(3)
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3)
    losses = []
    for _ in range(8):
        optimizer.zero_grad()
        loss = loss_of(model, images, R_gt)
        loss.backward()
        assert all(parameter.grad.abs().max() > 0 for parameter in model.parameters())
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.5 * losses[0]


def test_mixed_precision_gives_rotations_and_logits_in_32_bits():
    with torch.autocast("cpu", dtype=torch.bfloat16):
        R = network().eval()(pictures(2))
        logits = classifier().eval()(pictures(2), rotations(4))
    assert (R.dtype, logits.dtype) == (torch.float32, torch.float32)
    assert rotation_deviation(R.detach().double().numpy()).max() < 1e-6
