"""ResNet-18 as a backbone, in torchvision's names, so that its ImageNet weights fit (He et al., CVPR 2016)."""

from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from symsol_annot.bench.models.weights.imagenet import IMAGENET_URL, imagenet_file
from symsol_annot.bench.models.weights.state_dicts import load_weights, read_weights

FEATURES = 512
IMAGENET = "imagenet"  # in place of a path: the file that torchvision publishes
_WANTED = f"the weights of a ResNet-18 in torchvision's names, as in {IMAGENET_URL}"
_CLASSES = ("fc.weight", "fc.bias")  # from the features to ImageNet's classes
_COUNTER = "num_batches_tracked"
_LARGEST_PRODUCT = 2  # pixels: the side of the largest image whose convolution is computed as a matrix product


class ResNet18(nn.Module):
    """From normalised images (B, 3, H, W) to features (B, 512); ImageNet's layer of classes, `fc`, is left out."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, kernel_size=7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.layer1 = nn.Sequential(_Block(64, 64, stride=1), _Block(64, 64, stride=1))
        self.layer2 = nn.Sequential(_Block(64, 128, stride=2), _Block(128, 128, stride=1))
        self.layer3 = nn.Sequential(_Block(128, 256, stride=2), _Block(256, 256, stride=1))
        self.layer4 = nn.Sequential(_Block(256, FEATURES, stride=2), _Block(FEATURES, FEATURES, stride=1))

    def forward(self, images: Tensor) -> Tensor:
        """Return the features of images, averaged over what is left of their height and width (a 32nd)."""
        x = functional.relu(self.bn1(self.conv1(images)), inplace=True)
        x = functional.max_pool2d(x, kernel_size=3, stride=2, padding=1)
        for layer in (self.layer1, self.layer2, self.layer3, self.layer4):
            x = layer(x)
        return x.mean(dim=(-2, -1))


class _Block(nn.Module):
    """Two convolutions, and the input carried past them; where it changes shape, through a convolution of one pixel."""

    def __init__(self, channels_in: int, channels: int, *, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels_in, channels, kernel_size=3, stride=stride, padding=1, bias=False)
        self.bn1 = nn.BatchNorm2d(channels)
        self.conv2 = nn.Conv2d(channels, channels, kernel_size=3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(channels)
        self.downsample = nn.Sequential()
        if stride > 1:
            self.downsample.append(nn.Conv2d(channels_in, channels, kernel_size=1, stride=stride, bias=False))
            self.downsample.append(nn.BatchNorm2d(channels))

    def forward(self, x: Tensor) -> Tensor:
        y = functional.relu(self.bn1(_convolved(self.conv1, x)), inplace=True)
        return functional.relu(self.bn2(_convolved(self.conv2, y)) + self.downsample(x), inplace=True)


def _convolved(convolution: nn.Conv2d, x: Tensor) -> Tensor:
    """Return the convolution (B, C', H', W') of 3x3 pixels, padded by 1, of x (B, C, H, W).

    Where x has at most 2x2 pixels, much of the 3x3 weights meets padding alone, and what is left is a matrix product.
    On a CPU, torch's convolution of 1x1 pixels and its gradients are half of a training at 32 pixels.
    """
    size, stride = x.shape[-1], convolution.stride[0]
    if x.shape[-2] != size or size > _LARGEST_PRODUCT or not x.is_cpu:
        return cast("Tensor", convolution(x))
    if (size, stride) == (2, 1):
        return cast("Tensor", _ConvolvedFour.apply(x, convolution.weight))  # type: ignore[no-untyped-call]
    places = range(0, size, stride)
    met = [convolution.weight[..., 1 - i : 1 - i + size, 1 - j : 1 - j + size] for i in places for j in places]
    matrix = torch.stack(met, dim=1).flatten(2).flatten(0, 1)  # (C' H' W', C H W)
    return functional.linear(x.flatten(1), matrix).view(len(x), -1, len(places), len(places))


class _ConvolvedFour(torch.autograd.Function):
    """The convolution of 2x2 pixels, with stride 1: each meets each, through one of the nine places of the weights.

    All pixels are multiplied by all nine places at once, and the products that meet are added up: 36 products for 16,
    but the weights are copied once, as each place's matrix, where a matrix of what meets would hold them four times.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor) -> Tensor:
        """Return the convolution (B, C', 2, 2) of x (B, C, 2, 2) with weights (C', C, 3, 3)."""
        images, channels_in = x.shape[:2]
        of_places = weight.reshape(-1, 9).t().to(x.dtype, memory_format=torch.contiguous_format)
        of_places = of_places.reshape(-1, channels_in)  # (9 C', C)
        pixels = x.flatten(2).permute(2, 0, 1).reshape(-1, channels_in)  # (4 B, C)
        products = (pixels @ of_places.t()).view(4, images, 9, -1)
        sums = [sum(products[pixel, :, place] for pixel, place in meeting) for meeting in _MEETINGS]
        ctx.save_for_backward(pixels, of_places)
        ctx.weight_type = weight.dtype
        return torch.stack(cast("list[Tensor]", sums), dim=-1).view(images, -1, 2, 2)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor]:
        """Return the gradients of x and of the weights, given that (B, C', 2, 2) of the convolution."""
        pixels, of_places = ctx.saved_tensors
        images, channels_in = len(pixels) // 4, pixels.shape[1]
        of_each = gradients[0].flatten(2).permute(2, 0, 1)  # (4, B, C')
        of_products = of_each.new_zeros((4, images, 9, of_each.shape[-1]))
        for out, meeting in enumerate(_MEETINGS):
            for pixel, place in meeting:
                of_products[pixel, :, place] = of_each[out]
        of_products = of_products.view(len(pixels), -1)
        of_x = (of_products @ of_places).view(4, images, channels_in).permute(1, 2, 0)
        of_weight = (of_products.t() @ pixels).view(9, -1).t().to(ctx.weight_type)
        return of_x.reshape(images, channels_in, 2, 2), of_weight.reshape(-1, channels_in, 3, 3)


_PIXELS = [(0, 0), (0, 1), (1, 0), (1, 1)]
# of each pixel that comes out, which pixels it is made from, and through which of the nine places
_MEETINGS = [[(k, 3 * (i - a + 1) + j - b + 1) for k, (i, j) in enumerate(_PIXELS)] for a, b in _PIXELS]


def load_pretrained(resnet: nn.Module, pretrained: str | Path) -> None:
    """Give a ResNet-18 the weights of a file in torchvision's names.

    The layer of classes may be there, of any size, or not. Files from before torch 0.4.1, torchvision's own among
    them, lack the batches that each normalisation has seen; with a fixed momentum that count changes nothing.

    Args:
        resnet: takes the weights; left as it was where they cannot be had.
        pretrained: "imagenet" for torchvision's file, downloaded once to torch's cache; or the path of a file.

    Raises:
        WeightsError: no such file, no download, a damaged file, or another architecture.
    """
    path = imagenet_file() if pretrained == IMAGENET else Path(pretrained)
    weights = read_weights(path)
    for name in _CLASSES:
        weights.pop(name, None)
    counters = [name for name in resnet.state_dict() if name.endswith(_COUNTER)]
    if not any(name.endswith(_COUNTER) for name in weights):
        weights |= {name: torch.tensor(0) for name in counters}
    load_weights(resnet, weights, str(path), _WANTED)
