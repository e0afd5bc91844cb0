"""The backbone against ResNet-18 written out by its tensors' names."""

import math

import numpy as np
import pytest
import torch
from reference_models import network, pictures, with_statistics
from torch.nn import functional


def embeddings_by_hand(images, state):
    """ResNet-18 written out by its tensors' names, on channels normalised as in section 5.3; then E values and ReLU."""

    def norm(x, name):
        mean, variance, weight, bias = (
            state[f"resnet.{name}.{part}"][:, None, None] for part in ("running_mean", "running_var", "weight", "bias")
        )
        return (x - mean) / torch.sqrt(variance + 1e-5) * weight + bias

    def convolve(x, name, stride=1, padding=1):
        return functional.conv2d(x, state[f"resnet.{name}.weight"], stride=stride, padding=padding)

    channels = [
        (images[..., c].double() / 255 - mean) / deviation
        for c, (mean, deviation) in enumerate([(0.485, 0.229), (0.456, 0.224), (0.406, 0.225)])
    ]
    x = norm(convolve(torch.stack(channels, 1), "conv1", 2, 3), "bn1").clamp(min=0)
    x = functional.max_pool2d(functional.pad(x, (1, 1, 1, 1), value=-math.inf), 3, 2)
    for layer in ("layer1", "layer2", "layer3", "layer4"):
        for block in (f"{layer}.0", f"{layer}.1"):
            halved = 2 if block.endswith(".0") and layer != "layer1" else 1
            y = norm(convolve(x, f"{block}.conv1", halved), f"{block}.bn1").clamp(min=0)
            y = norm(convolve(y, f"{block}.conv2"), f"{block}.bn2")
            if halved == 2:
                x = norm(convolve(x, f"{block}.downsample.0", 2, 0), f"{block}.downsample.1")
            x = (x + y).clamp(min=0)
    features = x.sum(dim=(2, 3)) / (x.shape[2] * x.shape[3])
    return (features @ state["embedding.weight"].T + state["embedding.bias"]).clamp(min=0)


def test_an_embedding_is_the_resnets_features_through_a_layer_and_relu():
    stage = with_statistics(network().first_stage)
    images = pictures()
    found = stage(images)
    assert found.shape == (3, 256)
    assert 0.2 < (found == 0).double().mean() < 0.8
    np.testing.assert_allclose(found.detach(), embeddings_by_hand(images, stage.state_dict()).detach(), atol=1e-6)


@pytest.mark.parametrize("size", [32, 40, 64])
def test_small_inputs_have_the_same_embeddings_and_gradients(size):
    stage = with_statistics(network().first_stage)  # its last layers see 1, 2 and 2 pixels a side
    images = pictures(height=size, width=size)
    state = {
        name: value.detach().clone().requires_grad_(value.is_floating_point())
        for name, value in stage.state_dict().items()
    }
    found, expected = stage(images), embeddings_by_hand(images, state)
    np.testing.assert_allclose(found.detach(), expected.detach(), atol=1e-6)
    found.square().sum().backward()
    expected.square().sum().backward()
    for name, weight in stage.named_parameters():
        by_hand = state[name].grad
        assert torch.linalg.vector_norm(weight.grad - by_hand) < 1e-5 * torch.linalg.vector_norm(by_hand), name
