"""ImageNet's weights: torchvision's file, here from a folder in place of its server."""

import hashlib
import re

import pytest
import torch
from torchvision_weights import torchvision_weights

from symsol_annot.bench.models.networks.hypothesis_network import HypothesisNetwork
from symsol_annot.bench.models.networks.resnet import ResNet18, load_pretrained
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier
from symsol_annot.bench.models.weights import imagenet
from symsol_annot.bench.models.weights.imagenet import imagenet_file
from symsol_annot.errors import ModelError, WeightsError


@pytest.fixture
def server(tmp_path, monkeypatch, torchvision_file):
    """A folder with a file whose name tells its SHA-256, as ImageNet's does; and an empty cache."""
    digest = hashlib.sha256(torchvision_file.read_bytes()).hexdigest()
    published = tmp_path / f"resnet18-{digest[:8]}.pth"
    published.symlink_to(torchvision_file)
    monkeypatch.setattr(imagenet, "IMAGENET_URL", published.as_uri())
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "cache"))
    return published


def cached(tmp_path):
    return sorted((tmp_path / "cache" / "hub" / "checkpoints").glob("*"))


def test_the_url_is_torchvisions_and_names_a_digest():
    assert re.fullmatch(r"https://download\.pytorch\.org/models/resnet18-[0-9a-f]{8}\.pth", imagenet.IMAGENET_URL)


def test_imagenets_weights_are_downloaded_once_to_torchs_cache(server, tmp_path, capsys):
    model = ResNet18()
    load_pretrained(model, "imagenet")
    assert torch.equal(model.conv1.weight, torchvision_weights()["conv1.weight"])
    assert [path.name for path in cached(tmp_path)] == [server.name]
    server.unlink()
    assert imagenet_file() == cached(tmp_path)[0]
    printed = capsys.readouterr()
    assert (printed.out, printed.err) == ("", "")


@pytest.mark.parametrize("model", [HypothesisNetwork, RotationClassifier])
def test_no_download_is_an_error_and_no_random_start(model, server):
    server.unlink()
    with pytest.raises(WeightsError) as caught:
        model(3, pretrained="imagenet", rng=torch.Generator())
    message = str(caught.value)
    assert isinstance(caught.value, ModelError)
    assert server.as_uri() in message
    assert f"hub/checkpoints/{server.name}" in message
    assert "Put that file there yourself, give the path of a copy" in message


def test_a_download_of_other_bytes_is_an_error_and_not_kept(server, tmp_path):
    server.unlink()
    server.write_bytes(b"<html>a portal</html>")
    with pytest.raises(WeightsError, match="could not be downloaded"):
        load_pretrained(ResNet18(), "imagenet")
    assert cached(tmp_path) == []


def test_a_damaged_file_in_the_cache_is_named(server, tmp_path):
    imagenet_file()
    (path,) = cached(tmp_path)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(WeightsError, match="delete it, and it is downloaded again") as caught:
        load_pretrained(ResNet18(), "imagenet")
    assert str(path) in str(caught.value)


def test_a_cache_that_cannot_be_made_is_an_error(server, tmp_path):
    (tmp_path / "cache").write_text("a file")
    with pytest.raises(WeightsError, match="could not be downloaded"):
        load_pretrained(ResNet18(), "imagenet")


def test_a_path_that_is_missing_is_an_error_and_no_random_start(tmp_path):
    with pytest.raises(WeightsError, match="no such file"):
        HypothesisNetwork(3, pretrained=tmp_path / "resnet18.pth", rng=torch.Generator())
