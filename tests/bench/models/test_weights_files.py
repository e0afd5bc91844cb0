"""Files of weights, read and written: no code in them is run, damage is named, numbers stay what they were."""

import hashlib
import os
import pickle
import shutil
import subprocess
import sys

import pytest
import safetensors.torch
import torch
from torchvision_weights import safely_saved, same, saved

from symsol_annot.bench.models.weights.safetensors_file import read_content
from symsol_annot.bench.models.weights.state_dicts import read_weights, write_weights
from symsol_annot.errors import OutputError, WeightsError


def unprivileged(code, path):
    """What code says on standard error as a user who owns nothing here."""
    for folder in [*path.parents][:-2]:  # up to /tmp, which all may enter
        folder.chmod(folder.stat().st_mode | 0o055)
    words = ["setpriv", "--reuid=65534", "--clear-groups", sys.executable, "-c"]
    code = f"import sys; from pathlib import Path; {code}"
    return subprocess.run([*words, code, path], capture_output=True, text=True, check=False).stderr


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
