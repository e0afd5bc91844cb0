"""Fixtures: a set of tiny images, and trainings on it that were never stopped."""

import pytest
import torch
from forked_pickles import forked_pickles
from made_sets import make_set
from tiny_training import CPU, RECIPES
from torchvision_weights import torchvision_weights

from symsol_annot.bench.models.training import loop
from symsol_annot.bench.models.training.curve import plot_curve
from symsol_annot.bench.models.training.loop import train
from symsol_annot.sets.dataset import load

torch.set_num_threads(1)


@pytest.fixture(scope="session", autouse=True)
def _forked_pickles():
    """Files of torch.save are read in forks, which is faster than the processes that the product starts."""
    with forked_pickles():
        yield


def _plot_at_the_end(path, record):
    if record.is_finished:
        plot_curve(path, record)


@pytest.fixture(scope="module")
def cheap_curves():
    """No curve before the last epoch: drawing takes longer than the epochs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "plot_curve", _plot_at_the_end)
        yield


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """A folder of sets: tetX, of images so small that a training takes seconds."""
    folder = tmp_path_factory.mktemp("training") / "data"
    make_set(folder, "tetX", train=20, test=3, size=16, annotate="all")
    return folder


@pytest.fixture
def images(data):
    return load(data / "tetX", "train")


@pytest.fixture(scope="session")
def trained(data, tmp_path_factory):
    """A folder per architecture, each trained without a stop."""
    runs = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "plot_curve", _plot_at_the_end)
        for name, recipe in RECIPES.items():
            train(recipe, load(data / "tetX", "train"), runs / name, CPU, name=name)
    return {name: runs / name for name in RECIPES}


@pytest.fixture(scope="session")
def torchvision_file(tmp_path_factory):
    """A file as torchvision publishes it, with other numbers."""
    path = tmp_path_factory.mktemp("weights") / "resnet18.pth"
    torch.save(torchvision_weights(), path)
    return path
