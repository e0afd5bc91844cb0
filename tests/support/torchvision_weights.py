"""Weights with the names and shapes of torchvision's ResNet-18, and files of them."""

import safetensors.torch
import torch

# torchvision's resnet18: convolutions as their weights, of a batch normalisation the channels
TORCHVISION = """
conv1.weight 64 3 7 7
bn1 64
layer1.0.conv1.weight 64 64 3 3
layer1.0.bn1 64
layer1.0.conv2.weight 64 64 3 3
layer1.0.bn2 64
layer1.1.conv1.weight 64 64 3 3
layer1.1.bn1 64
layer1.1.conv2.weight 64 64 3 3
layer1.1.bn2 64
layer2.0.conv1.weight 128 64 3 3
layer2.0.bn1 128
layer2.0.conv2.weight 128 128 3 3
layer2.0.bn2 128
layer2.0.downsample.0.weight 128 64 1 1
layer2.0.downsample.1 128
layer2.1.conv1.weight 128 128 3 3
layer2.1.bn1 128
layer2.1.conv2.weight 128 128 3 3
layer2.1.bn2 128
layer3.0.conv1.weight 256 128 3 3
layer3.0.bn1 256
layer3.0.conv2.weight 256 256 3 3
layer3.0.bn2 256
layer3.0.downsample.0.weight 256 128 1 1
layer3.0.downsample.1 256
layer3.1.conv1.weight 256 256 3 3
layer3.1.bn1 256
layer3.1.conv2.weight 256 256 3 3
layer3.1.bn2 256
layer4.0.conv1.weight 512 256 3 3
layer4.0.bn1 512
layer4.0.conv2.weight 512 512 3 3
layer4.0.bn2 512
layer4.0.downsample.0.weight 512 256 1 1
layer4.0.downsample.1 512
layer4.1.conv1.weight 512 512 3 3
layer4.1.bn1 512
layer4.1.conv2.weight 512 512 3 3
layer4.1.bn2 512
fc.weight 1000 512
fc.bias 1000
"""


def torchvision_shapes():
    shapes = {}
    for line in TORCHVISION.split("\n")[1:-1]:
        name, *numbers = line.split()
        shape = tuple(int(n) for n in numbers)
        if name.endswith(("weight", "bias")):
            shapes[name] = shape
        else:
            shapes |= {f"{name}.{part}": shape for part in ("weight", "bias", "running_mean", "running_var")}
            shapes[f"{name}.num_batches_tracked"] = ()
    return shapes


def torchvision_weights(seed=0):
    rng = torch.Generator().manual_seed(seed)
    return {
        name: torch.tensor(7) if name.endswith("tracked") else 0.5 + torch.rand(shape, generator=rng)
        for name, shape in torchvision_shapes().items()
    }


def saved(tmp_path, content):
    path = tmp_path / "some.pth"
    torch.save(content, path)
    return path


def safely_saved(tmp_path, tensors):
    path = tmp_path / "some.safetensors"
    safetensors.torch.save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, path)
    return path


def same(a, b):
    return set(a) == set(b) and all(torch.equal(a[name], b[name]) for name in a)
