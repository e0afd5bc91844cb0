"""The thesis's network of M hypotheses per image (chapter 4)."""

from pathlib import Path

import roma
import torch
from torch import Tensor, nn

from symsol_annot.bench.models.networks.backbones import RESNET18, Backbone
from symsol_annot.bench.models.networks.first_stage import EMBEDDING_SIZE
from symsol_annot.bench.models.networks.reference_model import ReferenceModel, single_or_double
from symsol_annot.errors import SettingsError

_SHORTEST = 1e-6  # what a vector is divided by at least, so that gradients are finite


class HypothesisNetwork(ReferenceModel):
    """From images to M rotations each (figure 4.6): the first stage, and one layer to 6 values per hypothesis.

    Args:
        hypotheses: M.
        pretrained: where the backbone begins: "imagenet", the path of a file of its weights, or None, at random.
        rng: draws the weights of what is not pretrained, see `initialise`.
        backbone: of the first stage.
        input_size: the side in pixels that it reduces images to; 0 for images as they are.

    Raises:
        SettingsError: M is below 1.
        WeightsError: the pretrained weights cannot be had.
    """

    def __init__(
        self,
        hypotheses: int,
        *,
        pretrained: str | Path | None,
        rng: torch.Generator,
        backbone: Backbone = RESNET18,
        input_size: int = 0,
    ) -> None:
        if hypotheses < 1:
            raise SettingsError(f"expected 1 hypothesis or more, found {hypotheses}")
        with torch.random.fork_rng(devices=[]):  # torch's layers draw weights that are drawn again below
            super().__init__(backbone, input_size)
            self.output = nn.Linear(EMBEDDING_SIZE, 6 * hypotheses)
        self.hypotheses = hypotheses
        self.begin(pretrained, rng)

    def forward(self, images: Tensor) -> Tensor:
        """Return the hypotheses (B, M, 3, 3) of images (B, H, W, 3), uint8: R_m2c, on SO(3) to the last bits."""
        return self.from_embeddings(self.first_stage(images))

    def from_embeddings(self, embeddings: Tensor) -> Tensor:
        """Return the hypotheses (B, M, 3, 3) of embedded images (B, E)."""
        vectors = single_or_double(self.output(embeddings))
        return gram_schmidt(vectors.reshape(len(embeddings), self.hypotheses, 2, 3))


def gram_schmidt(vectors: Tensor) -> Tensor:
    """Return the rotations whose columns are x = x'/|x'|, y and z = x * y', normalised, with y = z * x (section 4.2.2).

    It is done twice: after once, the right angle between x and y is off by rounding over the sine of the angle between
    x' and y'. In 32 bits that is more than a predictions file may hold for 1 hypothesis in 100,000.

    Args:
        vectors: (..., 2, 3), x' and y', of any length.

    Returns:
        (..., 3, 3); no rotation where x' and y' are 0 or parallel.
    """
    R = roma.special_gramschmidt(vectors.mT, epsilon=_SHORTEST)
    return roma.special_gramschmidt(R, epsilon=_SHORTEST)
