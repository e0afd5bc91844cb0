"""What models in eval mode say of images, worked out in batches of bounded size, without gradients."""

import contextlib
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch._dynamo.exc import TorchDynamoException

from symsol_annot.bench.models.networks.hypothesis_network import HypothesisNetwork
from symsol_annot.bench.models.networks.reference_model import ReferenceModel
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier
from symsol_annot.errors import SettingsError

_ROTATIONS_AT_ONCE = 2**15
# float32: 1.4 times as fast as 2^12, whose hidden layers the caches do not hold; bfloat16: faster than 2^10 and 2^11
_ROTATIONS_AT_ONCE_ON_CPU = {"float32": 2**9, "bfloat16": 2**12}


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


class RotationScorer:
    """Scores rotations for one embedded image after another.

    Args:
        model: that is asked.
        products: the precision of its hidden layer's matrix product, "float32" or "bfloat16".
        is_compiled: whether torch.compile works on it first, for some seconds, which makes bfloat16 faster.
    """

    def __init__(self, model: RotationClassifier, products: str = "float32", *, is_compiled: bool = False) -> None:
        self._stage, self._products = model.second_stage, products
        self._of_whole_parts = self._stage.from_shares
        if is_compiled:
            self._of_whole_parts = torch.compile(self._stage.from_shares, dynamic=False)

    @torch.no_grad()
    def logits(self, embedding: Tensor, shares: Tensor) -> Tensor:
        """Return the logits (Q,) of an embedding (E,) at rotations.

        Args:
            embedding: of the first stage.
            shares: (Q, 256) of the rotations, as `RotationClassifier.shares` works them out.

        Raises:
            SettingsError: torch.compile fails.
        """
        at_once = _ROTATIONS_AT_ONCE_ON_CPU[self._products] if embedding.device.type == "cpu" else _ROTATIONS_AT_ONCE
        of_embedding = self._stage.share_of_embeddings(embedding)
        with matrix_products(embedding.device, self._products), _compiling():
            found = [
                (self._of_whole_parts if len(part) == at_once else self._stage.from_shares)(of_embedding, part)
                for part in torch.split(shares, at_once)  # for each other length it would be compiled again
            ]
        return torch.cat(found)


@torch.no_grad()
def probabilities(model: RotationClassifier, embedding: Tensor, R: Tensor) -> Tensor:
    """Return f(I, R) (Q,) of one embedded image (E,) at rotations (Q, 3, 3)."""
    return RotationScorer(model).logits(embedding, model.shares(R)).sigmoid()


@contextlib.contextmanager
def matrix_products(device: torch.device, precision: str) -> Iterator[None]:
    """Run what is inside with layers that multiply in "float32" or "bfloat16"; their sums are float32."""
    with torch.autocast(device.type, torch.bfloat16, enabled=precision == "bfloat16"):
        yield


@contextlib.contextmanager
def _compiling() -> Iterator[None]:
    """Run what is inside, which torch.compile may have to compile.

    Raises:
        SettingsError: it fails, for want of a C++ compiler, say.
    """
    try:
        yield
    except TorchDynamoException as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        raise SettingsError(
            f"compile: torch.compile fails here ({lines[0] if lines else type(error).__name__}); leave out --compile, "
            "or install a C++ compiler such as g++"
        ) from None
