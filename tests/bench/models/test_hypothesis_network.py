"""The network of hypotheses against its equations, written again in numpy."""

import numpy as np
import torch
from reference_models import network, pictures, seeded, with_statistics
from scipy.stats import kstest

from symsol_annot.bench.models.networks.hypothesis_network import gram_schmidt
from symsol_annot.rotations.so3 import rotation_deviation


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
