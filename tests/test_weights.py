"""Files of weights: torchvision's fit, others are refused with all that is wrong, and no code in them is run."""

import hashlib
import pickle
import re

import pytest
import safetensors.torch
import torch

from symsol_annot.bench import weights as weights_module
from symsol_annot.bench.models import HypothesisNetwork, RotationClassifier
from symsol_annot.bench.resnet import ResNet18, load_pretrained
from symsol_annot.bench.weights import load_weights, read_weights, write_weights
from symsol_annot.errors import ModelError, OutputError, WeightsError

torch.set_num_threads(1)

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


def flat_weights(**changes):
    """The same names and shapes in a small file: each tensor one number."""
    flat = {
        name: torch.tensor(7) if name.endswith("tracked") else torch.tensor(0.5).expand(shape)
        for name, shape in torchvision_shapes().items()
    }
    return flat | changes


@pytest.fixture(scope="module")
def torchvision_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "resnet18.pth"
    torch.save(torchvision_weights(), path)
    return path


def saved(tmp_path, content):
    path = tmp_path / "some.pth"
    torch.save(content, path)
    return path


def snapshot(model):
    return {name: tensor.clone() for name, tensor in model.state_dict().items()}


def same(a, b):
    return set(a) == set(b) and all(torch.equal(a[name], b[name]) for name in a)


def refusal(tmp_path, content):
    """The message with which a ResNet-18, left as it was, refuses a state dict."""
    model = ResNet18()
    before = snapshot(model)
    with pytest.raises(WeightsError) as caught:
        load_pretrained(model, saved(tmp_path, content))
    assert same(before, model.state_dict())
    assert str(tmp_path / "some.pth") in str(caught.value)
    return str(caught.value)


# --- names and shapes ---


def test_the_backbone_has_torchvisions_122_names_and_shapes_but_for_the_classes():
    shapes = torchvision_shapes()
    assert len(shapes) == 122
    del shapes["fc.weight"], shapes["fc.bias"]
    assert {name: tuple(tensor.shape) for name, tensor in ResNet18().state_dict().items()} == shapes


def test_torchvisions_file_loads_every_tensor(torchvision_file):
    model = ResNet18()
    load_pretrained(model, torchvision_file)
    expected = torchvision_weights()
    del expected["fc.weight"], expected["fc.bias"]
    assert same(expected, model.state_dict())


@pytest.mark.parametrize("model", [HypothesisNetwork, RotationClassifier])
def test_a_model_begins_with_the_pretrained_backbone(model, torchvision_file):
    start = {"rng": torch.Generator().manual_seed(0)}
    for path in (torchvision_file, str(torchvision_file)):
        begun = model(3, pretrained=path, **start).first_stage.resnet.state_dict()
        assert torch.equal(begun["layer3.0.conv2.weight"], torchvision_weights()["layer3.0.conv2.weight"])
        assert begun["bn1.num_batches_tracked"] == 7


def test_a_file_without_counts_of_batches_loads_as_torchvisions_own_has_none(tmp_path):
    old = {name: tensor for name, tensor in flat_weights().items() if not name.endswith("num_batches_tracked")}
    assert len(old) == 102
    model = ResNet18()
    load_pretrained(model, saved(tmp_path, old))
    assert model.state_dict()["layer4.1.bn2.num_batches_tracked"] == 0
    assert torch.equal(model.bn1.running_var, torch.full((64,), 0.5))


def test_a_file_without_some_of_its_counts_is_damaged(tmp_path):
    broken = flat_weights()
    del broken["layer2.0.bn1.num_batches_tracked"]
    assert "1 missing: layer2.0.bn1.num_batches_tracked" in refusal(tmp_path, broken)


@pytest.mark.parametrize("classes", [None, 10])
def test_the_layer_of_classes_may_be_of_any_size_or_missing(classes, tmp_path):
    weights = flat_weights()
    del weights["fc.weight"], weights["fc.bias"]
    if classes:
        weights |= {"fc.weight": torch.zeros(classes, 512), "fc.bias": torch.zeros(classes)}
    load_pretrained(ResNet18(), saved(tmp_path, weights))


def test_a_file_of_safetensors_loads_the_same(tmp_path):
    path = tmp_path / "resnet18.safetensors"
    safetensors.torch.save_file(torchvision_weights(), path)
    model = ResNet18()
    load_pretrained(model, path)
    assert torch.equal(model.layer4[1].bn2.running_mean, torchvision_weights()["layer4.1.bn2.running_mean"])


# --- refusals ---


def test_a_deeper_network_that_holds_all_of_resnet18_is_refused(tmp_path):
    """ResNet-34: the same blocks and more of them."""
    deeper = flat_weights()
    for layer, first, last, channels in ((1, 2, 3, 64), (2, 2, 4, 128), (3, 2, 6, 256), (4, 2, 3, 512)):
        for block in range(first, last):
            for part in (1, 2):
                name = f"layer{layer}.{block}"
                deeper[f"{name}.conv{part}.weight"] = torch.zeros(1).expand(channels, channels, 3, 3)
                deeper |= {
                    f"{name}.bn{part}.{leaf}": torch.zeros(1).expand(channels)
                    for leaf in ("weight", "bias", "running_mean", "running_var")
                }
                deeper[f"{name}.bn{part}.num_batches_tracked"] = torch.tensor(7)
    message = refusal(tmp_path, deeper)
    assert "not the weights of a ResNet-18" in message
    assert "96 not expected: layer1.2.conv1.weight" in message


def test_bottlenecks_are_refused_with_all_that_is_wrong(tmp_path):
    """As in ResNet-50: the first convolution has one pixel, and there is a third; one number is not finite."""
    other = flat_weights()
    other["layer1.0.conv1.weight"] = torch.zeros(64, 64, 1, 1)
    other["layer1.0.conv3.weight"] = torch.zeros(256, 64, 1, 1)
    del other["bn1.bias"]
    other["bn1.weight"] = torch.tensor(float("nan")).expand(64)
    message = refusal(tmp_path, other)
    assert "1 missing: bn1.bias" in message
    assert "1 not expected: layer1.0.conv3.weight" in message
    assert "1 of another shape: layer1.0.conv1.weight (64, 64, 1, 1) in place of (64, 64, 3, 3)" in message
    assert "1 not finite: bn1.weight" in message


@pytest.mark.parametrize("number", [float("nan"), float("inf"), 1e300])
def test_a_number_that_is_not_finite_in_the_model_is_refused(number, tmp_path):
    one = torch.full((64,), 0.5, dtype=torch.float64)
    one[63] = number
    assert "1 not finite: layer1.1.bn2.running_var" in refusal(
        tmp_path, flat_weights(**{"layer1.1.bn2.running_var": one})
    )


@pytest.mark.parametrize("dtype", [torch.int64, torch.complex64])
def test_another_type_of_number_is_refused(dtype, tmp_path):
    wrong = flat_weights(**{"bn1.weight": torch.ones(64, dtype=dtype)})
    assert "1 of another type: bn1.weight" in refusal(tmp_path, wrong)


def test_a_long_list_of_names_is_cut_and_counted():
    with pytest.raises(WeightsError, match=r"120 missing: conv1\.weight, bn1\.weight, bn1\.bias and 117 more"):
        load_weights(ResNet18(), {}, "here", "weights")


class _Bomb:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (type(self.path).touch, (self.path,))


def test_code_in_a_file_is_not_run(tmp_path):
    mark = tmp_path / "the code was run"
    bombs = {"torch": saved(tmp_path, {"conv1.weight": _Bomb(mark)}), "pickle": tmp_path / "plain.pth"}
    bombs["pickle"].write_bytes(pickle.dumps(_Bomb(mark)))
    for path in bombs.values():
        with pytest.raises(WeightsError, match="more than tensors") as caught:
            read_weights(path)
        assert "weights_only" not in str(caught.value)  # torch's own advice is to switch its guard off
    assert not mark.exists()
    pickle.loads(bombs["pickle"].read_bytes())
    assert mark.exists()


@pytest.mark.parametrize(
    ("content", "found"),
    [
        ({"epoch": 3, "model": {"a": torch.zeros(1)}}, r"epoch \(int\), model \(dict\)"),
        ({3: torch.zeros(1)}, r"3 \(Tensor\)"),
        ({"a": torch.zeros(2).to_sparse()}, r"a \(Tensor\)"),
        ([torch.zeros(1)], "found list"),
        (torch.zeros(1), "found Tensor"),
    ],
)
def test_what_is_no_state_dict_is_refused(content, found, tmp_path):
    with pytest.raises(WeightsError, match=found):
        read_weights(saved(tmp_path, content))


@pytest.mark.parametrize("name", ["cut.pth", "cut.safetensors"])
def test_a_damaged_file_is_refused(name, tmp_path):
    path = tmp_path / name
    whole = safetensors.torch.save({"a": torch.zeros(99)})
    if path.suffix == ".pth":
        whole = saved(tmp_path, {"a": torch.zeros(99)}).read_bytes()
    for part in (whole[:-100], whole[:40], b"", b"<html>404</html>"):
        path.write_bytes(part)
        with pytest.raises(WeightsError, match="is damaged") as caught:
            read_weights(path)
        assert str(path) in str(caught.value)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    for path in (tmp_path, tmp_path / "none.pth"):
        with pytest.raises(WeightsError, match="no such file"):
            read_weights(path)


def test_a_file_that_may_not_be_read_says_why(tmp_path, monkeypatch):
    path = saved(tmp_path, {})

    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(torch, "load", refuse)
    with pytest.raises(WeightsError, match="Permission denied"):
        read_weights(path)


# --- writing ---


def test_written_weights_are_read_as_they_were(tmp_path):
    model = torch.nn.Sequential(torch.nn.Conv2d(2, 3, 1), torch.nn.BatchNorm2d(3)).to(memory_format=torch.channels_last)
    write_weights(tmp_path / "model.safetensors", model)
    assert same(model.state_dict(), read_weights(tmp_path / "model.safetensors"))
    assert [path.name for path in tmp_path.iterdir()] == ["model.safetensors"]


def test_weights_are_written_under_a_name_that_says_what_they_are(tmp_path):
    with pytest.raises(WeightsError, match=r"end in \.safetensors"):
        write_weights(tmp_path / "model.pth", torch.nn.Linear(1, 1))
    with pytest.raises(OutputError, match="cannot be written"):
        write_weights(tmp_path / "no such folder" / "model.safetensors", torch.nn.Linear(1, 1))


# --- ImageNet's: torchvision's file, here from a folder in place of its server ---


@pytest.fixture
def server(tmp_path, monkeypatch, torchvision_file):
    """A folder with a file whose name tells its SHA-256, as ImageNet's does; and an empty cache."""
    digest = hashlib.sha256(torchvision_file.read_bytes()).hexdigest()
    published = tmp_path / f"resnet18-{digest[:8]}.pth"
    published.symlink_to(torchvision_file)
    monkeypatch.setattr(weights_module, "IMAGENET_URL", published.as_uri())
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "cache"))
    return published


def cached(tmp_path):
    return sorted((tmp_path / "cache" / "hub" / "checkpoints").glob("*"))


def test_the_url_is_torchvisions_and_names_a_digest():
    assert re.fullmatch(r"https://download\.pytorch\.org/models/resnet18-[0-9a-f]{8}\.pth", weights_module.IMAGENET_URL)


def test_imagenets_weights_are_downloaded_once_to_torchs_cache(server, tmp_path, capsys):
    model = ResNet18()
    load_pretrained(model, "imagenet")
    assert torch.equal(model.conv1.weight, torchvision_weights()["conv1.weight"])
    assert [path.name for path in cached(tmp_path)] == [server.name]
    server.unlink()
    load_pretrained(ResNet18(), "imagenet")
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
    load_pretrained(ResNet18(), "imagenet")
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
