"""The classifier of rotations against its equations, written again in numpy."""

import contextlib
import math
import re

import numpy as np
import pytest
import torch
from reference_models import classifier, pictures, rotations, seeded, with_statistics

from symsol_annot.bench.models.networks.answers import RotationScorer, matrix_products
from symsol_annot.bench.models.networks.rotation_classifier import positional_encoding
from symsol_annot.errors import RotationError, SettingsError

compiles = pytest.mark.filterwarnings("ignore:`torch.jit.script_method` is deprecated:DeprecationWarning")


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


def test_only_products_within_are_rounded():
    layer, values = torch.nn.Linear(64, 64), torch.randn(8, 64, generator=torch.Generator().manual_seed(0))
    whole = layer(values)
    with contextlib.suppress(KeyError), matrix_products(torch.device("cpu"), "bfloat16"):
        rounded = layer(values)
        raise KeyError
    with matrix_products(torch.device("cpu"), "float32"):
        assert torch.equal(layer(values), whole)
    assert torch.equal(layer(values), whole)
    assert 1e-6 < (rounded.float() - whole).abs().max() < 0.02


@compiles
@pytest.mark.parametrize(("products", "tolerance"), [("float32", 1e-5), ("bfloat16", 0.02)])
def test_a_compiled_scorer_gives_the_logits_of_one_that_is_not(products, tolerance):
    """Of whole parts, and of the rest that is not as long."""
    model, rng = classifier().eval(), torch.Generator().manual_seed(0)
    embedding, shares = torch.randn(256, generator=rng), torch.randn(2**12 + 100, 256, generator=rng)
    plain, compiled = (RotationScorer(model, products, is_compiled=one).logits(embedding, shares) for one in (0, 1))
    assert len(plain) == len(compiled) == len(shares)
    torch.testing.assert_close(plain, compiled, atol=tolerance, rtol=0)


@compiles
def test_where_nothing_can_be_compiled_an_error_says_what_to_do(monkeypatch):
    monkeypatch.setenv("CXX", "/no/compiler")
    monkeypatch.setattr(torch._inductor.config.cpp, "cxx", (None, "/no/compiler"))
    torch._dynamo.reset()
    scorer = RotationScorer(classifier().eval(), is_compiled=True)
    with (
        torch._inductor.utils.fresh_inductor_cache(),
        pytest.raises(SettingsError, match=r"torch.compile fails here .*; leave out --compile"),
    ):
        scorer.logits(torch.zeros(256), torch.zeros(2**9, 256))
