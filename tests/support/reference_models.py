"""Reference models drawn from a seed, images and rotations to ask them about, and their losses."""

import numpy as np
import torch

from symsol_annot.bench.models.losses import classification_loss, von_mises_loss, winner_takes_all
from symsol_annot.bench.models.networks.hypothesis_network import HypothesisNetwork
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier
from symsol_annot.rotations.so3 import uniform_rotations

torch.set_num_threads(1)


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def network(hypotheses=4, seed=0):
    return HypothesisNetwork(hypotheses, pretrained=None, rng=seeded(seed))


def classifier(frequencies=3, seed=0):
    return RotationClassifier(frequencies, pretrained=None, rng=seeded(seed))


def pictures(count=3, seed=0, height=33, width=40):
    """Images that differ a lot, of a shape in which height and width cannot be mistaken for each other."""
    shades = torch.randint(0, 256, (count, 1, 1, 3), generator=seeded(seed))
    noise = torch.randint(-60, 60, (count, height, width, 3), generator=seeded(seed + 1))
    return (shades + noise).clamp(0, 255).to(torch.uint8)


def rotations(count, seed=0):
    return torch.from_numpy(uniform_rotations(count, np.random.default_rng(seed)))


def with_statistics(model):
    """The model in double precision and in eval mode, its normalisations as after training: no two alike."""
    rng = seeded(9)
    for layer in model.modules():
        if isinstance(layer, torch.nn.BatchNorm2d):
            for tensor in (layer.weight.data, layer.running_var):
                tensor.uniform_(0.5, 1.5, generator=rng)
            for tensor in (layer.bias.data, layer.running_mean):
                tensor.normal_(0.0, 0.3, generator=rng)
    return model.double().eval()


def snapshot(module):
    return {name: tensor.clone() for name, tensor in module.state_dict().items()}


def changed(module, before):
    return {name for name, tensor in module.state_dict().items() if not torch.equal(tensor, before[name])}


def loss_of_network(model, images, R_gt):
    return winner_takes_all(von_mises_loss(model(images), R_gt[:, None].float())).mean()


def loss_of_classifier(model, images, R_gt):
    negatives = rotations(len(images) * 20, seed=4).reshape(len(images), 20, 3, 3)
    logits = model(images, torch.cat([R_gt[:, None], negatives], dim=1))
    return classification_loss(logits[:, 0], logits[:, 1:]).mean()
