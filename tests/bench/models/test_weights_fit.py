"""Which weights fit a ResNet-18: torchvision's do, others are refused with all that is wrong."""

import re

import pytest
import safetensors.torch
import torch
from torchvision_weights import safely_saved, same, torchvision_shapes, torchvision_weights

from symsol_annot.bench.models.networks.hypothesis_network import HypothesisNetwork
from symsol_annot.bench.models.networks.resnet import ResNet18, load_pretrained
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier
from symsol_annot.bench.models.weights.state_dicts import load_weights
from symsol_annot.errors import WeightsError


def flat_weights(**changes):
    """The same names and shapes in a small file: each tensor one number."""
    flat = {
        name: torch.tensor(7) if name.endswith("tracked") else torch.tensor(0.5).expand(shape)
        for name, shape in torchvision_shapes().items()
    }
    return flat | changes


def snapshot(model):
    return {name: tensor.clone() for name, tensor in model.state_dict().items()}


def refusal(tmp_path, content):
    """The message with which a ResNet-18, left as it was, refuses a state dict."""
    model = ResNet18()
    before = snapshot(model)
    with pytest.raises(WeightsError) as caught:
        load_pretrained(model, safely_saved(tmp_path, content))
    assert same(before, model.state_dict())
    assert str(tmp_path / "some.safetensors") in str(caught.value)
    return str(caught.value)


# --- names and shapes ---


def test_the_backbone_has_torchvisions_122_names_and_shapes_but_for_the_classes():
    shapes = torchvision_shapes()
    assert len(shapes) == 122
    del shapes["fc.weight"], shapes["fc.bias"]
    assert {name: tuple(tensor.shape) for name, tensor in ResNet18().state_dict().items()} == shapes


def test_torchvisions_file_loads_every_tensor(torchvision_file):
    model = ResNet18()
    load_pretrained(model, torchvision_file)
    expected = torchvision_weights()
    del expected["fc.weight"], expected["fc.bias"]
    assert same(expected, model.state_dict())


@pytest.mark.parametrize("model", [HypothesisNetwork, RotationClassifier])
def test_a_model_begins_with_the_pretrained_backbone(model, tmp_path):
    start = {"rng": torch.Generator().manual_seed(0)}
    file = safely_saved(tmp_path, torchvision_weights())
    for path in (file, str(file)):
        begun = model(3, pretrained=path, **start).first_stage.resnet.state_dict()
        assert torch.equal(begun["layer3.0.conv2.weight"], torchvision_weights()["layer3.0.conv2.weight"])
        assert begun["bn1.num_batches_tracked"] == 7


def test_a_file_without_counts_of_batches_loads_as_torchvisions_own_has_none(tmp_path):
    old = {name: tensor for name, tensor in flat_weights().items() if not name.endswith("num_batches_tracked")}
    assert len(old) == 102
    model = ResNet18()
    load_pretrained(model, safely_saved(tmp_path, old))
    assert model.state_dict()["layer4.1.bn2.num_batches_tracked"] == 0
    assert torch.equal(model.bn1.running_var, torch.full((64,), 0.5))


def test_a_file_without_some_of_its_counts_is_damaged(tmp_path):
    broken = flat_weights()
    del broken["layer2.0.bn1.num_batches_tracked"]
    assert "1 missing: layer2.0.bn1.num_batches_tracked" in refusal(tmp_path, broken)


@pytest.mark.parametrize("classes", [None, 10])
def test_the_layer_of_classes_may_be_of_any_size_or_missing(classes, tmp_path):
    weights = flat_weights()
    del weights["fc.weight"], weights["fc.bias"]
    if classes:
        weights |= {"fc.weight": torch.zeros(classes, 512), "fc.bias": torch.zeros(classes)}
    model = ResNet18()
    load_pretrained(model, safely_saved(tmp_path, weights))
    assert torch.equal(model.conv1.weight, weights["conv1.weight"])


def test_a_file_of_safetensors_loads_the_same(tmp_path):
    path = tmp_path / "resnet18.safetensors"
    safetensors.torch.save_file(torchvision_weights(), path)
    model = ResNet18()
    load_pretrained(model, path)
    assert torch.equal(model.layer4[1].bn2.running_mean, torchvision_weights()["layer4.1.bn2.running_mean"])


# --- refusals ---


def test_a_deeper_network_that_holds_all_of_resnet18_is_refused(tmp_path):
    """ResNet-34: the same blocks and more of them."""
    deeper = flat_weights()
    for layer, first, last, channels in ((1, 2, 3, 64), (2, 2, 4, 128), (3, 2, 6, 256), (4, 2, 3, 512)):
        for block in range(first, last):
            for part in (1, 2):
                name = f"layer{layer}.{block}"
                deeper[f"{name}.conv{part}.weight"] = torch.zeros(1).expand(channels, channels, 3, 3)
                deeper |= {
                    f"{name}.bn{part}.{leaf}": torch.zeros(1).expand(channels)
                    for leaf in ("weight", "bias", "running_mean", "running_var")
                }
                deeper[f"{name}.bn{part}.num_batches_tracked"] = torch.tensor(7)
    message = refusal(tmp_path, deeper)
    assert "not the weights of a ResNet-18" in message
    assert re.search(r"96 not expected: layer\d\.", message)


def test_bottlenecks_are_refused_with_all_that_is_wrong(tmp_path):
    """As in ResNet-50: the first convolution has one pixel, and there is a third; one number is not finite."""
    other = flat_weights()
    other["layer1.0.conv1.weight"] = torch.zeros(64, 64, 1, 1)
    other["layer1.0.conv3.weight"] = torch.zeros(256, 64, 1, 1)
    del other["bn1.bias"]
    other["bn1.weight"] = torch.tensor(float("nan")).expand(64)
    message = refusal(tmp_path, other)
    assert "1 missing: bn1.bias" in message
    assert "1 not expected: layer1.0.conv3.weight" in message
    assert "1 of another shape: layer1.0.conv1.weight (64, 64, 1, 1) in place of (64, 64, 3, 3)" in message
    assert "1 not finite: bn1.weight" in message


@pytest.mark.parametrize("number", [float("nan"), float("inf"), 1e300])
def test_a_number_that_is_not_finite_in_the_model_is_refused(number, tmp_path):
    one = torch.full((64,), 0.5, dtype=torch.float64)
    one[63] = number
    assert "1 not finite: layer1.1.bn2.running_var" in refusal(
        tmp_path, flat_weights(**{"layer1.1.bn2.running_var": one})
    )


@pytest.mark.parametrize("dtype", [torch.int64, torch.complex64])
def test_another_type_of_number_is_refused(dtype, tmp_path):
    wrong = flat_weights(**{"bn1.weight": torch.ones(64, dtype=dtype)})
    assert "1 of another type: bn1.weight" in refusal(tmp_path, wrong)


def test_a_long_list_of_names_is_cut_and_counted():
    with pytest.raises(WeightsError, match=r"120 missing: conv1\.weight, bn1\.weight, bn1\.bias and 117 more"):
        load_weights(ResNet18(), {}, "here", "weights")
