"""What all models have: a first stage, from images to embeddings, and weights that are drawn from one generator."""

from pathlib import Path

import torch
from torch import Tensor, nn

from symsol_annot.bench.models.networks.backbones import Backbone
from symsol_annot.bench.models.networks.first_stage import FirstStage


class ReferenceModel(nn.Module):
    """A model that begins with a first stage and reads the images of a set as they are: (B, H, W, 3) uint8.

    Args:
        backbone: of the first stage.
        input_size: the side in pixels that the first stage reduces images to; 0 for images as they are.
    """

    def __init__(self, backbone: Backbone, input_size: int = 0) -> None:
        super().__init__()
        self._backbone = backbone
        self.first_stage = FirstStage(backbone, input_size)

    @property
    def device(self) -> torch.device:
        """Where its weights are."""
        return self.first_stage.channel_mean.device

    def begin(self, pretrained: str | Path | None, rng: torch.Generator) -> None:
        """Draw the first weights, and take a backbone's pretrained ones.

        Raises:
            WeightsError: the pretrained weights cannot be had.
        """
        initialise(self, rng)
        if pretrained is not None:
            self._backbone.load_pretrained(self.first_stage.backbone, pretrained)


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


def single_or_double(values: Tensor) -> Tensor:
    """Return values in 32 bits or more, where mixed precision gave fewer."""
    return values.to(torch.promote_types(values.dtype, torch.float32))
