"""The first stage that all models share: from the images of a set, as they are, to embeddings (section 5.3)."""

from pathlib import Path
from typing import Self

import torch
from torch import Tensor, nn
from torch.nn import functional

from symsol_annot.bench.models.batches import reduced
from symsol_annot.bench.models.networks.backbones import RESNET18, Backbone
from symsol_annot.bench.models.weights.safetensors_file import StateDict
from symsol_annot.bench.models.weights.state_dicts import load_weights, read_weights
from symsol_annot.errors import ModelError, WeightsError

EMBEDDING_SIZE = 256  # E

# ImageNet's colours, of channels in [0, 1]: what the backbone's weights were trained on
CHANNEL_MEAN = (0.485, 0.456, 0.406)
CHANNEL_DEVIATION = (0.229, 0.224, 0.225)
_IN_A_MODEL = "first_stage."  # before its weights' names in a whole model


class FirstStage(nn.Module):
    """From images to embeddings: a backbone, a fully connected layer to E values, ReLU.

    Frozen, it computes one fixed function, whatever mode the model is in: no gradients, and batch normalisation by the
    running statistics, which stay as they are. The statistics of a batch would change the embeddings from batch to
    batch, and the running ones would drift away from those that the weights were trained with.

    Args:
        backbone: what it begins with.
        input_size: the side in pixels that larger or smaller images are reduced to; 0 takes them as they are.
    """

    def __init__(self, backbone: Backbone = RESNET18, input_size: int = 0) -> None:
        super().__init__()
        self._input_size = input_size
        self._prefix = backbone.prefix
        self.add_module(backbone.prefix, backbone.build())
        self.embedding = nn.Linear(backbone.features, EMBEDDING_SIZE)
        self.channel_mean: Tensor
        self.channel_deviation: Tensor
        self.register_buffer("channel_mean", _per_channel(CHANNEL_MEAN), persistent=False)
        self.register_buffer("channel_deviation", _per_channel(CHANNEL_DEVIATION), persistent=False)
        self._is_frozen = False
        self._wants_training = True

    @property
    def backbone(self) -> nn.Module:
        """The network from normalised images (B, 3, H, W) to features (B, F)."""
        backbone: nn.Module = getattr(self, self._prefix)
        return backbone

    def forward(self, images: Tensor) -> Tensor:
        """Return the embeddings (B, E) of images (B, H, W, 3), uint8.

        Raises:
            ModelError: other images.
        """
        if images.dtype != torch.uint8 or images.ndim != 4 or images.shape[-1] != 3:
            raise ModelError(
                f"expected images (B, H, W, 3) uint8, as a set stores them and not normalised, found "
                f"{tuple(images.shape)} {images.dtype}"
            )
        channels_first = reduced(images, self._input_size).permute(0, 3, 1, 2).to(self.channel_mean.dtype)
        features = self.backbone((channels_first / 255.0 - self.channel_mean) / self.channel_deviation)
        return functional.relu(self.embedding(features))

    def load_hypothesis_network(self, path: Path) -> None:
        """Take the first stage of a trained HypothesisNetwork, whatever its M, from the file of its weights.

        Raises:
            WeightsError: no such file, a damaged one, or not a hypothesis network's.
        """
        self.take_hypothesis_network(read_weights(path), str(path))

    def take_hypothesis_network(self, weights: StateDict, source: str) -> None:
        """Take the first stage of a trained HypothesisNetwork, whatever its M.

        Args:
            weights: all of the network's.
            source: where they come from, for error messages.

        Raises:
            WeightsError: they are not a hypothesis network's with the same backbone.
        """
        own = {name.removeprefix(_IN_A_MODEL): weights[name] for name in weights if name.startswith(_IN_A_MODEL)}
        others = sorted(set(weights) - {_IN_A_MODEL + name for name in own})
        if others != ["output.bias", "output.weight"]:
            raise WeightsError(
                f"{source}: expected the weights of a HypothesisNetwork, {_IN_A_MODEL}* and output.*, found others: "
                f"{', '.join(others[:3]) or 'no output.*'}"
            )
        load_weights(self, own, source, "the weights of a HypothesisNetwork's first stage")

    def freeze(self) -> None:
        """Keep weights and running statistics as they are, until `unfreeze`; an optimiser leaves them alone."""
        self._is_frozen = True
        self.requires_grad_(requires_grad=False)
        self.zero_grad(set_to_none=True)
        super().train(mode=False)

    def unfreeze(self) -> None:
        """Let it learn again, in the mode that the model is in."""
        self._is_frozen = False
        self.requires_grad_(requires_grad=True)
        self.train(self._wants_training)

    def train(self, mode: bool = True) -> Self:  # noqa: FBT001, FBT002  # as torch has it
        """Set the mode, which waits for `unfreeze` while it is frozen."""
        self._wants_training = mode
        return super().train(mode and not self._is_frozen)


def _per_channel(values: tuple[float, float, float]) -> Tensor:
    return torch.tensor(values)[:, None, None]
