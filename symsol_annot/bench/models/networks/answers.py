"""What models in eval mode say of images, worked out in batches of bounded size, without gradients."""

import contextlib
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from symsol_annot.bench.models.networks.hypothesis_network import HypothesisNetwork
from symsol_annot.bench.models.networks.reference_model import ReferenceModel
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier

_ROTATIONS_AT_ONCE = 2**15
# float32: 1.4 times as fast as 2^12, whose hidden layers the caches do not hold; bfloat16: twice as fast as 2^9
_ROTATIONS_AT_ONCE_ON_CPU = {"float32": 2**9, "bfloat16": 2**13}
_MATMUL_PRECISION = {"float32": "highest", "bfloat16": "medium"}  # torch's names


@torch.no_grad()
def all_hypotheses(model: HypothesisNetwork, images: Tensor, batch_size: int) -> npt.NDArray[np.float32]:
    """Return the hypotheses (N, M, 3, 3) of images (N, H, W, 3), uint8, on any device, in float32."""
    model.eval()
    device = model.device
    return torch.cat([model(part.to(device)).cpu() for part in torch.split(images, batch_size)]).numpy()


@torch.no_grad()
def embeddings_of(model: ReferenceModel, images: Tensor, batch_size: int) -> Tensor:
    """Return the embeddings (N, E), on the model's device, of images (N, H, W, 3), uint8, on any device."""
    model.eval()
    device = model.device
    return torch.cat([model.first_stage(part.to(device)) for part in torch.split(images, batch_size)])


@torch.no_grad()
def probabilities(model: RotationClassifier, embedding: Tensor, R: Tensor) -> Tensor:
    """Return f(I, R) (Q,) of one embedded image (E,) at rotations (Q, 3, 3)."""
    return logits_at(model, embedding, model.shares(R)).sigmoid()


@torch.no_grad()
def logits_at(model: RotationClassifier, embedding: Tensor, shares: Tensor, products: str = "float32") -> Tensor:
    """Return the logits (Q,) of one embedded image at rotations.

    Args:
        model: that is asked.
        embedding: (E,).
        shares: (Q, 256) of the rotations, as `RotationClassifier.shares` works them out.
        products: the precision of matrix products, "float32" or "bfloat16".
    """
    at_once = _ROTATIONS_AT_ONCE_ON_CPU[products] if embedding.device.type == "cpu" else _ROTATIONS_AT_ONCE
    with matrix_products(products):
        return torch.cat([model.logits_from_shares(embedding, part) for part in torch.split(shares, at_once)])


@contextlib.contextmanager
def matrix_products(precision: str) -> Iterator[None]:
    """Run what is inside with what a CPU multiplies in matrix products in "float32" or "bfloat16"; sums are float32."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision(_MATMUL_PRECISION[precision])
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)
