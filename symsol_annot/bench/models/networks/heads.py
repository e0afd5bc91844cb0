"""The thesis's models: M hypotheses an image (chapter 4), and a classifier of rotations (chapter 6).

Both begin with the same first stage and read the images of a set as they are: (B, H, W, 3) uint8.
"""

import math
from pathlib import Path

import roma
import torch
from torch import Tensor, nn
from torch.nn import functional

from symsol_annot.bench.models.networks.first_stage import EMBEDDING_SIZE, FirstStage
from symsol_annot.bench.models.networks.resnet import load_pretrained
from symsol_annot.errors import RotationError, SettingsError

HIDDEN_SIZE = 256  # of the classifier's two hidden layers
FREQUENCIES = 3  # F
_SHORTEST = 1e-6  # what a vector is divided by at least, so that gradients are finite


class HypothesisNetwork(nn.Module):
    """From images to M rotations each (figure 4.6): the first stage, and one layer to 6 values a hypothesis.

    Args:
        hypotheses: M.
        pretrained: where ResNet-18 begins: "imagenet", the path of a file in torchvision's names, or None, at random.
        rng: draws the weights of what is not pretrained, see `initialise`.

    Raises:
        SettingsError: M is below 1.
        WeightsError: the pretrained weights cannot be had.
    """

    def __init__(self, hypotheses: int, *, pretrained: str | Path | None, rng: torch.Generator) -> None:
        super().__init__()
        if hypotheses < 1:
            raise SettingsError(f"expected 1 hypothesis or more, found {hypotheses}")
        self.hypotheses = hypotheses
        with torch.random.fork_rng(devices=[]):  # torch's layers draw weights that are drawn again below
            self.first_stage = FirstStage()
            self.output = nn.Linear(EMBEDDING_SIZE, 6 * hypotheses)
        _begin(self, self.first_stage, pretrained, rng)

    def forward(self, images: Tensor) -> Tensor:
        """Return the hypotheses (B, M, 3, 3) of images (B, H, W, 3), uint8: R_m2c, on SO(3) to the last bits."""
        return self.from_embeddings(self.first_stage(images))

    def from_embeddings(self, embeddings: Tensor) -> Tensor:
        """Return the hypotheses (B, M, 3, 3) of embedded images (B, E)."""
        vectors = _single_or_double(self.output(embeddings))
        return gram_schmidt(vectors.reshape(len(embeddings), self.hypotheses, 2, 3))


class RotationClassifier(nn.Module):
    """From images and rotations to logits: is R in S(I)? (figure 6.4). The probability f(I, R) is their sigmoid.

    Args:
        frequencies: F; 0 gives the second stage the 9 entries themselves, section 7.4's model without encoding.
        pretrained: where ResNet-18 begins: "imagenet", the path of a file in torchvision's names, or None, at random.
            `first_stage.load_hypothesis_network` replaces it by a trained first stage.
        rng: draws the weights of what is not pretrained, see `initialise`.

    Raises:
        SettingsError: F is negative.
        WeightsError: the pretrained weights cannot be had.
    """

    def __init__(self, frequencies: int = FREQUENCIES, *, pretrained: str | Path | None, rng: torch.Generator) -> None:
        super().__init__()
        if frequencies < 0:
            raise SettingsError(f"expected 0 frequencies or more, found {frequencies}")
        self.frequencies = frequencies
        encoding_size = 9 * 2 * frequencies or 9
        with torch.random.fork_rng(devices=[]):
            self.first_stage = FirstStage()
            self.second_stage = _SecondStage(encoding_size)
        _begin(self, self.first_stage, pretrained, rng)

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
        return _single_or_double(self.second_stage(embeddings, positional_encoding(R.flatten(-2), self.frequencies)))


class _SecondStage(nn.Module):
    """From an embedding side by side with an encoded rotation to a logit: two hidden layers with ReLU."""

    def __init__(self, encoding_size: int) -> None:
        super().__init__()
        self.entry = nn.Linear(EMBEDDING_SIZE + encoding_size, HIDDEN_SIZE)
        self.hidden = nn.Linear(HIDDEN_SIZE, HIDDEN_SIZE)
        self.logit = nn.Linear(HIDDEN_SIZE, 1)

    def forward(self, embeddings: Tensor, encoded: Tensor) -> Tensor:
        # A layer on values side by side is the sum of a layer on each: an embedding's share is worked out once an
        # image, and that of rotations which the images have in common once for all of them.
        of_embedding, of_rotation = self.entry.weight.tensor_split([EMBEDDING_SIZE], dim=1)
        shares = functional.linear(embeddings, of_embedding, self.entry.bias)[:, None]
        x = functional.relu(shares + functional.linear(encoded.to(of_rotation.dtype), of_rotation))
        logits: Tensor = self.logit(functional.relu(self.hidden(x)))
        return logits.squeeze(-1)


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


def initialise(model: nn.Module, rng: torch.Generator) -> None:
    """Draw a model's weights, which the thesis leaves open: as torchvision and torch draw them.

    Convolutions are normal with variance 2 / fan-out (He et al., ICCV 2015), fully connected layers uniform within
    1 / sqrt(fan-in), biases too; batch normalisation begins as the identity. The hypotheses of an image then begin
    close to uniform on SO(3).
    """
    for layer in model.modules():
        if isinstance(layer, nn.Conv2d):
            nn.init.kaiming_normal_(layer.weight, mode="fan_out", nonlinearity="relu", generator=rng)
        elif isinstance(layer, nn.Linear):
            bound = layer.in_features**-0.5
            for parameter in (layer.weight, layer.bias):
                nn.init.uniform_(parameter, -bound, bound, generator=rng)


def _begin(model: nn.Module, first_stage: FirstStage, pretrained: str | Path | None, rng: torch.Generator) -> None:
    initialise(model, rng)
    if pretrained is not None:
        load_pretrained(first_stage.resnet, pretrained)


def _single_or_double(values: Tensor) -> Tensor:
    """Return values in 32 bits or more, where mixed precision gave fewer."""
    return values.to(torch.promote_types(values.dtype, torch.float32))
