"""The thesis's classifier of rotations (chapter 6)."""

import math
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from symsol_annot.bench.models.networks.backbones import RESNET18, Backbone
from symsol_annot.bench.models.networks.first_stage import EMBEDDING_SIZE
from symsol_annot.bench.models.networks.reference_model import ReferenceModel
from symsol_annot.errors import RotationError, SettingsError

HIDDEN_SIZE = 256  # of the classifier's two hidden layers
FREQUENCIES = 3  # F


class RotationClassifier(ReferenceModel):
    """From images and rotations to logits: is R in S(I)? (figure 6.4). The probability f(I, R) is their sigmoid.

    Args:
        frequencies: F; 0 gives the second stage the 9 entries themselves, section 7.4's model without encoding.
        pretrained: where the backbone begins: "imagenet", the path of a file of its weights, or None, at random.
            `first_stage.load_hypothesis_network` replaces it by a trained first stage.
        rng: draws the weights of what is not pretrained, see `initialise`.
        backbone: of the first stage.
        input_size: the side in pixels that it reduces images to; 0 for images as they are.

    Raises:
        SettingsError: F is negative.
        WeightsError: the pretrained weights cannot be had.
    """

    def __init__(
        self,
        frequencies: int = FREQUENCIES,
        *,
        pretrained: str | Path | None,
        rng: torch.Generator,
        backbone: Backbone = RESNET18,
        input_size: int = 0,
    ) -> None:
        if frequencies < 0:
            raise SettingsError(f"expected 0 frequencies or more, found {frequencies}")
        encoding_size = 9 * 2 * frequencies or 9
        with torch.random.fork_rng(devices=[]):  # torch's layers draw weights that are drawn again below
            super().__init__(backbone, input_size)
            self.second_stage = SecondStage(encoding_size)
        self.frequencies = frequencies
        self.begin(pretrained, rng)

    def forward(self, images: Tensor, R: Tensor) -> Tensor:
        """Return the logits (B, Q) of images (B, H, W, 3), uint8, at rotations (Q, 3, 3) or (B, Q, 3, 3)."""
        return self.logits(self.first_stage(images), R)

    def logits(self, embeddings: Tensor, R: Tensor) -> Tensor:
        """Return the logits (B, Q) of embedded images at rotations, as many as memory holds (about 2 kB each).

        Args:
            embeddings: (B, E) of the first stage.
            R: (Q, 3, 3), or (B, Q, 3, 3).

        Raises:
            RotationError: rotations of another shape.
        """
        if R.shape[-2:] != (3, 3) or R.ndim not in {3, 4} or (R.ndim == 4 and len(R) != len(embeddings)):
            raise RotationError(
                f"expected rotations (Q, 3, 3) or ({len(embeddings)}, Q, 3, 3), for {len(embeddings)} images, "
                f"found {tuple(R.shape)}"
            )
        return self.second_stage(embeddings, positional_encoding(R.flatten(-2), self.frequencies))

    def shares(self, R: Tensor) -> Tensor:
        """Return what rotations (Q, 3, 3) bring to the second stage's first layer (Q, 256), for all images the same."""
        return self.second_stage.share_of_rotations(positional_encoding(R.flatten(-2), self.frequencies))


class SecondStage(nn.Module):
    """From an embedding side by side with an encoded rotation to a logit: two hidden layers with ReLU."""

    def __init__(self, encoding_size: int) -> None:
        super().__init__()
        self.entry = nn.Linear(EMBEDDING_SIZE + encoding_size, HIDDEN_SIZE)
        self.hidden = nn.Linear(HIDDEN_SIZE, HIDDEN_SIZE)
        self.logit = nn.Linear(HIDDEN_SIZE, 1)

    def forward(self, embeddings: Tensor, encoded: Tensor) -> Tensor:
        """Return the logits (B, Q) of embeddings (B, E) at encoded rotations (Q, n) or (B, Q, n).

        A layer on values side by side is the sum of a layer on each: an embedding's share is worked out once per image,
        and that of rotations which the images have in common once for all of them.
        """
        return self.from_shares(self.share_of_embeddings(embeddings)[:, None], self.share_of_rotations(encoded))

    def share_of_embeddings(self, embeddings: Tensor) -> Tensor:
        """Return what embeddings (B, E) bring to the first layer (B, 256)."""
        return functional.linear(embeddings, self.entry.weight[:, :EMBEDDING_SIZE], self.entry.bias)

    def share_of_rotations(self, encoded: Tensor) -> Tensor:
        """Return what encoded rotations (..., n) bring to the first layer (..., 256)."""
        of_rotation = self.entry.weight[:, EMBEDDING_SIZE:]
        return functional.linear(encoded.to(of_rotation.dtype), of_rotation)

    def from_shares(self, of_embeddings: Tensor, of_rotations: Tensor) -> Tensor:
        """Return the logits (...) of what both bring, (..., 256) of shapes that fit each other."""
        hidden = functional.relu(self.hidden(functional.relu(of_embeddings + of_rotations)))
        with torch.autocast(hidden.device.type, enabled=False):  # bfloat16 would round a logit of 20 by 0.06
            weight = self.logit.weight[0]  # times a vector: the gradient of a layer of one value is slow on a CPU
            return hidden.to(weight.dtype) @ weight + self.logit.bias


def positional_encoding(values: Tensor, frequencies: int) -> Tensor:
    """Return gamma of each value (eq. 6.11): sin and cos of 2^0 pi x, then of 2^1 pi x, up to 2^(F-1) pi x.

    Args:
        values: (..., n).
        frequencies: F; 0 returns the values themselves.

    Returns:
        (..., n 2F), the 2F of one value side by side.
    """
    if frequencies == 0:
        return values
    octaves = 2.0 ** torch.arange(frequencies, dtype=values.dtype, device=values.device)
    angles = math.pi * octaves * values[..., None]
    return torch.stack([angles.sin(), angles.cos()], dim=-1).flatten(-3)
