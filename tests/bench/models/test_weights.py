"""Files of weights: torchvision's fit, others are refused with all that is wrong, and no code in them is run."""

import hashlib
import io
import json
import os
import pickle
import re
import shutil
import struct
import subprocess
import sys
import zipfile

import pytest
import safetensors.torch
import torch

from symsol_annot.bench.models.networks.hypothesis_network import HypothesisNetwork
from symsol_annot.bench.models.networks.resnet import ResNet18, load_pretrained
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier
from symsol_annot.bench.models.weights import imagenet
from symsol_annot.bench.models.weights.imagenet import imagenet_file
from symsol_annot.bench.models.weights.safetensors_file import read_content
from symsol_annot.bench.models.weights.state_dicts import load_weights, read_weights, write_weights
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


def safely_saved(tmp_path, tensors):
    path = tmp_path / "some.safetensors"
    safetensors.torch.save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, path)
    return path


def unprivileged(code, path):
    """What code says on standard error as a user who owns nothing here."""
    for folder in [*path.parents][:-2]:  # up to /tmp, which all may enter
        folder.chmod(folder.stat().st_mode | 0o055)
    words = ["setpriv", "--reuid=65534", "--clear-groups", sys.executable, "-c"]
    code = f"import sys; from pathlib import Path; {code}"
    return subprocess.run([*words, code, path], capture_output=True, text=True, check=False).stderr


def snapshot(model):
    return {name: tensor.clone() for name, tensor in model.state_dict().items()}


def same(a, b):
    return set(a) == set(b) and all(torch.equal(a[name], b[name]) for name in a)


def refusal(tmp_path, content):
    """The message with which a ResNet-18, left as it was, refuses a state dict."""
    model = ResNet18()
    before = snapshot(model)
    with pytest.raises(WeightsError) as caught:
        load_pretrained(model, safely_saved(tmp_path, content))
    assert same(before, model.state_dict())
    assert str(tmp_path / "some.safetensors") in str(caught.value)
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
def test_a_model_begins_with_the_pretrained_backbone(model, tmp_path):
    start = {"rng": torch.Generator().manual_seed(0)}
    file = safely_saved(tmp_path, torchvision_weights())
    for path in (file, str(file)):
        begun = model(3, pretrained=path, **start).first_stage.resnet.state_dict()
        assert torch.equal(begun["layer3.0.conv2.weight"], torchvision_weights()["layer3.0.conv2.weight"])
        assert begun["bn1.num_batches_tracked"] == 7


def test_a_file_without_counts_of_batches_loads_as_torchvisions_own_has_none(tmp_path):
    old = {name: tensor for name, tensor in flat_weights().items() if not name.endswith("num_batches_tracked")}
    assert len(old) == 102
    model = ResNet18()
    load_pretrained(model, safely_saved(tmp_path, old))
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
    model = ResNet18()
    load_pretrained(model, safely_saved(tmp_path, weights))
    assert torch.equal(model.conv1.weight, weights["conv1.weight"])


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
    assert re.search(r"96 not expected: layer\d\.", message)


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
        ({3: torch.zeros(1)}, r"a name of type int \(Tensor\)"),
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


@pytest.mark.parametrize("suffix", [".pth", ".safetensors"])
def test_what_is_no_regular_file_is_refused_without_waiting(suffix, tmp_path):
    (tmp_path / f"folder{suffix}").mkdir()
    os.mkfifo(tmp_path / f"fifo{suffix}")
    (tmp_path / f"device{suffix}").symlink_to("/dev/zero")
    (tmp_path / f"lost{suffix}").symlink_to(tmp_path / "nowhere")
    said = {"folder": "is a folder", "fifo": "is no regular file", "device": "is no regular file"}
    said |= {"lost": "no such file", "none": "no such file"}
    for name, what in said.items():
        with pytest.raises(WeightsError, match=what):
            read_weights(tmp_path / f"{name}{suffix}")


@pytest.mark.skipif(not shutil.which("setpriv") or os.getuid() != 0, reason="root drops its privileges here")
def test_a_file_that_may_not_be_read_says_why(tmp_path):
    path = safely_saved(tmp_path, {"a": torch.zeros(1)})
    path.chmod(0)
    said = unprivileged("from symsol_annot.bench.weights import read_weights; read_weights(Path(sys.argv[1]))", path)
    assert "WeightsError" in said
    assert "cannot be read: Permission denied" in said


# --- files that were made to do harm ---


def file_of(header, data=b"", length=None):
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text) if length is None else length) + text + data


def one(dtype="F32", shape=(2,), offsets=(0, 8), **more):
    return {"a": {"dtype": dtype, "shape": list(shape), "data_offsets": list(offsets), **more}}


EIGHT = bytes(8)
LIES = {
    "a header longer than the file": (file_of(one(), EIGHT, 2**40), "header is said to have 1,099,511,627,776 bytes"),
    "a header of 2^64 bytes": (file_of(one(), EIGHT, 2**64 - 1), "header is said to have"),
    "a header of 100 MB": (file_of(b" " * 10**8), "more than the 16,777,216 that are read"),
    "no header": (file_of(b""), "Expecting value"),
    "half a length": (b"\1\0\0", "ends before its last byte"),
    "no JSON": (file_of(b"{'a': 1}"), "Expecting property name"),
    "no UTF-8": (file_of(b'{"\xff": 1}'), "codec can't decode"),
    "a list": (file_of([1]), "expected to be tensors by their names"),
    "nested deep": (file_of(b"[" * 200_000), "nested too deep"),
    "a number of 10^5 digits": (file_of(b'{"a": ' + b"9" * 100_000 + b"}"), "Exceeds the limit"),
    "metadata that are no text": (file_of({"__metadata__": {"a": 1}, **one()}, EIGHT), "texts by their names"),
    "metadata that are a list": (file_of({"__metadata__": [], **one()}, EIGHT), "texts by their names"),
    "a tensor that is a list": (file_of({"a": []}), "expected to have a type of"),
    "a type that is none": (file_of(one(dtype="F128"), EIGHT), "expected to have a type of"),
    "a type that is a list": (file_of(one(dtype=["F32"]), EIGHT), "expected to have a type of"),
    "no shape": (file_of({"a": {"dtype": "F32", "data_offsets": [0, 8]}}, EIGHT), "a shape and offsets"),
    "a key too many": (file_of(one(code="x"), EIGHT), "a shape and offsets"),
    "a negative shape": (file_of(one(shape=(-2, -1)), EIGHT), "shape of up to 8"),
    "a shape of true": (file_of(one(shape=(True, 2)), EIGHT), "shape of up to 8"),
    "a shape of fractions": (file_of(one(shape=(2.0,)), EIGHT), "shape of up to 8"),
    "nine dimensions": (file_of(one(shape=(2, *8 * [1])), EIGHT), "shape of up to 8"),
    "2^60 elements": (file_of(one(shape=(2**30, 2**30))), "expected to have 4,611,686,018,427,387,904 bytes"),
    "2^60 elements of none": (file_of(one(shape=(0, 2**60), offsets=(0, 0))), "shape of up to 8"),
    "fewer bytes than its shape": (file_of(one(shape=(3,)), EIGHT), "expected to have 12 bytes by its shape, found 8"),
    "offsets beyond the file": (file_of(one(shape=(200,), offsets=(0, 800)), EIGHT), "header tells of"),
    "offsets backwards": (file_of(one(offsets=(8, 0)), EIGHT), "expected to have 8 bytes by its shape, found -8"),
    "bytes that are no tensor's": (file_of(one(), 2 * EIGHT), "header tells of"),
    "a hole": (file_of(one(offsets=(8, 16)), 2 * EIGHT), "begins at 8, expected 0"),
    "tensors over each other": (
        file_of({**one(), "b": {"dtype": "F32", "shape": [2], "data_offsets": [4, 12]}}, EIGHT + bytes(4)),
        "'b' begins at 4, expected 8",
    ),
    "5,000 tensors": (
        file_of({f"a{i}": {"dtype": "F32", "shape": [0], "data_offsets": [0, 0]} for i in range(5000)}),
        "5,000 tensors, more than the 4,096",
    ),
}


@pytest.mark.parametrize(("data", "said"), LIES.values(), ids=LIES)
def test_a_header_that_lies_is_refused_before_memory_is_taken_for_it(data, said, tmp_path):
    path = tmp_path / "a.safetensors"
    path.write_bytes(data)
    with pytest.raises(WeightsError, match=said) as caught:
        read_weights(path)
    assert len(str(caught.value)) < 1000


def test_every_type_of_number_is_read_as_the_library_of_safetensors_wrote_it(tmp_path):
    kinds = ["float64", "float32", "float16", "bfloat16", "complex64", "int64", "int32", "int16", "int8", "uint8"]
    tensors = {kind: torch.arange(6).reshape(2, 3).to(getattr(torch, kind)) for kind in kinds}
    tensors |= {"scalar": torch.tensor(3.5), "nothing": torch.zeros(0, 4)}
    path = safely_saved(tmp_path, tensors)
    found = read_content(path)
    assert same(tensors, found.tensors)
    assert {name: tensor.dtype for name, tensor in found.tensors.items()} == {n: t.dtype for n, t in tensors.items()}
    assert found.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_file_that_is_cut_off_after_it_was_read_changes_nothing(tmp_path):
    """A file mapped into memory would end the process here, by SIGBUS."""
    path = safely_saved(tmp_path, {"a": torch.ones(2**20)})
    weights = read_weights(path)
    os.truncate(path, 100)
    assert weights["a"].sum() == 2**20


def pickled(*parts):
    """A pickle of protocol 2 from opcodes."""
    return b"\x80\x02" + b"".join(parts) + b"."


def called(module, name, *arguments):
    return b"c" + f"{module}\n{name}\n".encode() + b"(" + b"".join(arguments) + b"tR"


def whole(number):
    data = number.to_bytes(8, "little", signed=True)
    return b"\x8a\x08" + data


def torch_zip(pickle_bytes, compression=zipfile.ZIP_STORED, **files):
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", compression) as file:
        file.writestr("archive/data.pkl", pickle_bytes)
        file.writestr("archive/version", b"3\n")
        file.writestr("archive/byteorder", b"little")
        for name, content in files.items():
            file.writestr(f"archive/data/{name[1:]}", content)
    return data.getvalue()


def a_tuple_of_itself_twice(levels):
    return b"(t" + b"".join(b"2\x86" for _ in range(levels))


STORAGE = b"(X\x07\0\0\0storagectorch\nFloatStorage\nX\x01\0\0\x000X\x03\0\0\0cpu" + whole(2**40) + b"tQ"
BOMBS = {
    "a name that takes for ever to hash": torch_zip(pickled(b"}", a_tuple_of_itself_twice(60), b"Ns")),
    "terabytes of nothing": torch_zip(pickled(called("__builtin__", "bytearray", whole(2**42)))),
    "a gigabyte of nothing": torch_zip(pickled(called("__builtin__", "bytearray", whole(2**30)))),
    "a tensor of terabytes": torch_zip(pickled(called("torch", "Tensor", whole(2**40)))),
    "a storage of terabytes": torch_zip(pickled(STORAGE), _0=b"1234"),
    "a zip bomb": torch_zip(pickled(STORAGE), zipfile.ZIP_DEFLATED, _0=bytes(2**27)),
    "a place of 2^31 in the memo": torch_zip(pickled(b"Nr" + struct.pack("<I", 2**31 - 1))),
    "a pickle of 2^60 bytes": torch_zip(b"\x80\x04\x8d" + struct.pack("<Q", 2**60)),
}


READ = """
import json, resource, sys
from pathlib import Path
from symsol_annot.bench.models.weights.state_dicts import read_weights
from symsol_annot.errors import WeightsError
for path in map(Path, sys.argv[1:]):
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    try:
        said = f"read {len(read_weights(path))}"
    except WeightsError as error:
        said = str(error)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(json.dumps([path.stem, said, used.ru_utime - before, used.ru_maxrss]))
"""


def test_a_pickle_that_asks_for_time_or_memory_without_end_is_refused_in_bounds(tmp_path):
    """In a process of its own, for a child is counted with the memory of its parent."""
    for name, data in BOMBS.items():
        (tmp_path / f"{name}.pth").write_bytes(data)
    done = subprocess.run(
        [sys.executable, "-c", READ, *(tmp_path / f"{name}.pth" for name in BOMBS)],
        capture_output=True,
        text=True,
        check=True,
    )
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert [name for name, *_ in answers] == list(BOMBS)
    for name, said, seconds, kibibytes in answers:
        assert re.search("is damaged|expected tensors by their names", said), name
        assert len(said) < 500
        assert seconds < 20.0, name
        assert kibibytes < 2**20, name


def test_one_number_that_stands_for_a_gigabyte_is_not_written_out(tmp_path):
    with pytest.raises(WeightsError, match=r"1 tensors of 1,073,741,824 bytes, more than"):
        read_weights(saved(tmp_path, {"a": torch.zeros(1).expand(2**28)}))


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
