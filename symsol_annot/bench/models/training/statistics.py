"""Batch normalisation's means and variances, taken anew from many images at once (Wu and Johnson, 2021)."""

import torch
from torch import Tensor, nn


@torch.no_grad()
def retake_statistics(first_stage: nn.Module, images: Tensor) -> None:
    """Give batch normalisation the means and variances of some images, with which it then evaluates.

    Running averages are of the batches of training, and a layer's batches depend on those of the layer before it. Of a
    set in which many images are one and the same, such as those of a ball that show none of its parts, they are far
    from what the images have together.

    Args:
        first_stage: whose layers of batch normalisation are meant; it is left in the mode that it was in.
        images: (N, H, W, 3) uint8, on its device; all are in memory at once.
    """
    layers = [layer for layer in first_stage.modules() if isinstance(layer, nn.modules.batchnorm._BatchNorm)]  # noqa: SLF001
    momenta, was_training = [layer.momentum for layer in layers], first_stage.training
    for layer in layers:
        layer.momentum = 1.0
    first_stage.train()
    first_stage(images)
    first_stage.train(was_training)
    for layer, momentum in zip(layers, momenta, strict=True):
        layer.momentum = momentum
