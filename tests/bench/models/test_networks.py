"""The models against their equations, written again in numpy and by tensors' names; and what freezing leaves alone."""

import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.stats import kstest
from torch.nn import functional

from symsol_annot.bench.models.losses import classification_loss, von_mises_loss, winner_takes_all
from symsol_annot.bench.models.networks.first_stage import FirstStage
from symsol_annot.bench.models.networks.hypothesis_network import HypothesisNetwork, gram_schmidt
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier, positional_encoding
from symsol_annot.bench.models.weights.state_dicts import read_weights, write_weights
from symsol_annot.errors import ModelError, RotationError, SettingsError, WeightsError
from symsol_annot.rotations.so3 import rotation_deviation, uniform_rotations

torch.set_num_threads(1)
ROOT = Path(__file__).resolve().parents[3]


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def network(hypotheses=4, seed=0):
    return HypothesisNetwork(hypotheses, pretrained=None, rng=seeded(seed))


def classifier(frequencies=3, seed=0):
    return RotationClassifier(frequencies, pretrained=None, rng=seeded(seed))


def pictures(count=3, seed=0, height=33, width=40):
    """Images that differ a lot, of a shape in which height and width cannot be mistaken for each other."""
    shades = torch.randint(0, 256, (count, 1, 1, 3), generator=seeded(seed))
    noise = torch.randint(-60, 60, (count, height, width, 3), generator=seeded(seed + 1))
    return (shades + noise).clamp(0, 255).to(torch.uint8)


def rotations(count, seed=0):
    return torch.from_numpy(uniform_rotations(count, np.random.default_rng(seed)))


def with_statistics(model):
    """The model in double precision and in eval mode, its normalisations as after training: no two alike."""
    rng = seeded(9)
    for layer in model.modules():
        if isinstance(layer, torch.nn.BatchNorm2d):
            for tensor in (layer.weight.data, layer.running_var):
                tensor.uniform_(0.5, 1.5, generator=rng)
            for tensor in (layer.bias.data, layer.running_mean):
                tensor.normal_(0.0, 0.3, generator=rng)
    return model.double().eval()


def snapshot(module):
    return {name: tensor.clone() for name, tensor in module.state_dict().items()}


def changed(module, before):
    return {name for name, tensor in module.state_dict().items() if not torch.equal(tensor, before[name])}


# --- the first stage ---


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


def test_an_image_keeps_its_place_in_a_batch():
    model = network().eval()
    images = pictures()
    alone = torch.cat([model(image[None]) for image in images])
    np.testing.assert_allclose(model(images).detach(), alone.detach(), atol=1e-5)
    assert (alone[0] - alone[1]).abs().max() > 1e-3


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


# --- hypotheses ---


def gram_schmidt_by_hand(x, y):
    """The thesis's steps: x' to length 1, z = x * y' to length 1, y = z * x."""
    x = x / np.linalg.norm(x)
    z = np.cross(x, y)
    z = z / np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1)


def test_hypotheses_are_the_last_layers_pairs_of_vectors_made_rotations():
    model = with_statistics(network(hypotheses=5))
    images = pictures()
    embeddings = model.first_stage(images).detach().numpy()
    weight, bias = (model.state_dict()[f"output.{part}"].numpy() for part in ("weight", "bias"))
    found = model(images).detach().numpy()
    assert found.shape == (3, 5, 3, 3)
    for b in range(3):
        values = weight @ embeddings[b] + bias
        for m in range(5):
            x, y = values[6 * m : 6 * m + 3], values[6 * m + 3 : 6 * m + 6]
            np.testing.assert_allclose(found[b, m], gram_schmidt_by_hand(x, y), atol=1e-12)


def test_columns_are_the_axes_in_order():
    vectors = torch.tensor([[[0.0, 2.0, 0.0], [0.0, 5.0, 3.0]]])  # x' along y, y' in the plane of y and z
    expected = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    assert gram_schmidt(vectors).tolist() == [expected]


def test_hypotheses_in_32_bits_are_rotations_even_of_nearly_parallel_vectors():
    x = torch.randn(2000, 3, generator=seeded())
    aside = torch.randn(2000, 3, generator=seeded(1))
    for closeness in (1.0, 1e-2, 1e-4):
        found = gram_schmidt(torch.stack([x, 3 * x + closeness * aside], dim=1))
        assert found.dtype == torch.float32
        assert rotation_deviation(found.double().numpy()).max() < 1e-6  # a predictions file may be 1e-5 off


def test_gradients_of_gram_schmidt():
    vectors = torch.randn(4, 2, 3, dtype=torch.float64, generator=seeded(), requires_grad=True)
    assert torch.autograd.gradcheck(gram_schmidt, vectors)


def test_no_vector_gives_gradients_that_are_not_finite():
    for pair in ([[0.0] * 3, [0.0] * 3], [[1.0, 0, 0], [2.0, 0, 0]], [[1e-30, 0, 0], [0, 1e-30, 0]]):
        vectors = torch.tensor(pair, requires_grad=True)
        gram_schmidt(vectors).square().sum().backward()
        assert vectors.grad.isfinite().all()


def test_hypotheses_begin_uniform_on_rotations():
    """The angle to any rotation, of uniform ones, is distributed as (a - sin a) / pi."""
    model = network(hypotheses=1500).eval()
    with torch.no_grad():
        R = model(pictures(1))[0].double().numpy()
    for reference in (np.eye(3), np.diag([1.0, -1, -1])):
        cosines = (np.einsum("mij,ij->m", R, reference) - 1) / 2
        assert kstest(np.arccos(cosines.clip(-1, 1)), lambda a: (a - np.sin(a)) / np.pi).pvalue > 1e-3


# --- the classifier ---


def encoding_by_hand(x, frequencies):
    return [f(2**k * math.pi * x) for k in range(frequencies) for f in (math.sin, math.cos)]


def test_positional_encoding_is_equation_6_11_for_each_value():
    values = torch.rand(2, 9, dtype=torch.float64, generator=seeded()) * 2 - 1
    for frequencies in (1, 3, 5):
        found = positional_encoding(values, frequencies)
        assert found.shape == (2, 9 * 2 * frequencies)
        for row, by_row in zip(values.tolist(), found.tolist(), strict=True):
            expected = [number for x in row for number in encoding_by_hand(x, frequencies)]
            np.testing.assert_allclose(by_row, expected, atol=1e-14)


@pytest.mark.parametrize(("frequencies", "size"), [(3, 54), (1, 18), (0, 9)])
def test_a_logit_is_of_the_embedding_beside_the_encoded_entries(frequencies, size):
    """Two hidden layers of 256 with ReLU; with no frequencies, the 9 entries themselves."""
    model = with_statistics(classifier(frequencies))
    images, R = pictures(2), rotations(6).reshape(2, 3, 3, 3)
    embeddings = model.first_stage(images).detach().numpy()
    state = {name: tensor.numpy() for name, tensor in model.second_stage.state_dict().items()}
    assert state["entry.weight"].shape == (256, 256 + size)
    found = model(images, R).detach().numpy()
    assert found.shape == (2, 3)
    for b in range(2):
        for q in range(3):
            entries = R[b, q].flatten().tolist()
            encoded = entries if not frequencies else [v for x in entries for v in encoding_by_hand(x, frequencies)]
            x = np.concatenate([embeddings[b], encoded])
            for layer in ("entry", "hidden"):
                x = np.maximum(0, state[f"{layer}.weight"] @ x + state[f"{layer}.bias"])
            expected = state["logit.weight"] @ x + state["logit.bias"]
            np.testing.assert_allclose(found[b, q], expected[0], rtol=0, atol=1e-12)


def test_rotations_that_images_share_are_asked_of_each():
    model = classifier().eval()
    images, R = pictures(), rotations(7)
    shared, each = model(images, R), model(images, R.expand(3, 7, 3, 3))
    assert shared.shape == (3, 7)
    np.testing.assert_allclose(shared.detach(), each.detach(), atol=1e-6)
    assert (shared[0] - shared[1]).abs().max() > 1e-4


def test_one_pass_of_the_backbone_answers_any_number_of_rotations():
    model = classifier().eval()
    passes = []
    model.first_stage.resnet.register_forward_hook(lambda *_: passes.append(1))
    embeddings = model.first_stage(pictures(2))
    R = rotations(1000)
    in_parts = torch.cat([model.logits(embeddings, part) for part in R.split(300)], dim=1)
    assert len(passes) == 1
    np.testing.assert_allclose(model(pictures(2), R).detach(), in_parts.detach(), atol=1e-6)
    assert len(passes) == 2


@pytest.mark.parametrize("shape", [(3, 3), (5, 9), (3, 5, 3, 3), (1, 5, 3, 3), (2, 5, 3, 4), (1, 2, 5, 3, 3)])
def test_rotations_of_another_shape_are_refused(shape):
    with pytest.raises(RotationError, match=re.escape(str(shape))):
        classifier().logits(torch.zeros(2, 256), torch.zeros(shape))


# --- how models begin, and learn ---


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


def loss_of_network(model, images, R_gt):
    return winner_takes_all(von_mises_loss(model(images), R_gt[:, None].float())).mean()


def loss_of_classifier(model, images, R_gt):
    negatives = rotations(len(images) * 20, seed=4).reshape(len(images), 20, 3, 3)
    logits = model(images, torch.cat([R_gt[:, None], negatives], dim=1))
    return classification_loss(logits[:, 0], logits[:, 1:]).mean()


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


# --- the first stage of another model, and frozen ---


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


# --- around the models ---


def test_scoring_and_writing_predictions_load_no_torch():
    code = (
        "import sys, symsol_annot.bench.scoring.scoring, symsol_annot.bench.submission, "
        "symsol_annot.bench.scoring.reference, symsol_annot.plotting.contact_sheet\n"
        "print([name for name in ('torch', 'roma', 'safetensors') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_examples_of_the_models_page_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {"images": pictures(2), "R_gt": rotations(2), "negatives": rotations(2 * 5).reshape(2, 5, 3, 3)}
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs/models.md").read_text(), flags=re.DOTALL)
    for block in blocks:
        exec(block.replace('pretrained="imagenet"', "pretrained=None"), names)
    assert names["hypotheses"].shape == (2, 30, 3, 3)
    assert names["probability"].shape == (2, 4608)
    assert set(read_weights(tmp_path / "network.safetensors")) == set(names["network"].state_dict())
