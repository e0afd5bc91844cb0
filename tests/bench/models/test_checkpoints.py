"""Checkpoints: a damaged, foreign or hostile file is refused, and a whole one is one file's."""

import hashlib
import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
import safetensors.torch
import torch
from changed_checkpoints import copy_of
from tiny_training import CPU, HYPOTHESES

from symsol_annot.bench.models.recipe import recipe_to_toml
from symsol_annot.bench.models.training.checkpoints import open_checkpoint
from symsol_annot.bench.models.training.loop import train
from symsol_annot.bench.models.training.pretraining import trained_networks
from symsol_annot.bench.models.weights.state_dicts import read_weights
from symsol_annot.errors import WeightsError


@pytest.mark.parametrize("damage", ["cut", "no checkpoint", "of a later version", "another architecture", "bad recipe"])
def test_a_damaged_or_foreign_checkpoint_is_refused(damage, trained, tmp_path):
    whole, path = trained["hypotheses"] / "weights.safetensors", tmp_path / "weights.safetensors"
    match damage:
        case "cut":
            path.write_bytes(whole.read_bytes()[:-1000])
            said = "the checkpoint is damaged"
        case "no checkpoint":
            safetensors.torch.save_file({"a": torch.zeros(1)}, path)
            said = "no checkpoint of `symsol-annot train`"
        case "of a later version":
            copy_of(whole, path, metadata={"format_version": "2"})
            said = "is of format version 2, newer than 1, .* update it"
        case "another architecture":
            copy_of(whole, path, lambda tensors: tensors.update(extra=tensors.pop("output.bias")))
            said = r"not the weights of its recipe, hypotheses:\n  - 1 missing: output.bias"
        case "bad recipe":
            copy_of(whole, path, metadata={"recipe": "model = 'hypotheses'"})
            said = "what it says of its training is damaged"
    with pytest.raises(WeightsError, match=said):
        open_checkpoint(path)


def test_a_damaged_state_is_refused_and_nothing_lost(trained, images, tmp_path):
    out = tmp_path / "run"
    out.mkdir()
    state = trained["hypotheses"] / "state.safetensors"

    def transpose(tensors):
        tensors["exp_avg/output.weight"] = tensors["exp_avg/output.weight"].T.contiguous()

    copy_of(state, out / "state.safetensors", transpose)
    before = (out / "state.safetensors").read_bytes()
    with pytest.raises(WeightsError, match=r"Adam's means of output.weight are not of its shape"):
        train(HYPOTHESES, images, out, CPU, name="hypotheses")
    assert (out / "state.safetensors").read_bytes() == before
    (out / "state.safetensors").write_bytes(before[:5000])
    with pytest.raises(WeightsError, match="is damaged"):
        train(HYPOTHESES, images, out, CPU, name="hypotheses")


@pytest.mark.parametrize("place", [0.0, 0.3, 0.99])
def test_a_bit_flipped_in_the_tensors_is_refused(trained, images, tmp_path, place):
    out = Path(shutil.copytree(trained["hypotheses"], tmp_path / "run"))
    for name in ("weights.safetensors", "state.safetensors"):
        data = bytearray((out / name).read_bytes())
        begin = 8 + int.from_bytes(data[:8], "little")
        data[begin + int(place * (len(data) - begin))] ^= 1
        (out / name).write_bytes(data)
    with pytest.raises(WeightsError, match="is damaged: its contents have another SHA-256"):
        open_checkpoint(out)
    with pytest.raises(WeightsError, match="is damaged: its contents have another SHA-256"):
        train(HYPOTHESES, images, out, CPU, name="hypotheses")
    assert (out / "state.safetensors").read_bytes() == bytes(data)


def test_a_checkpoint_whose_digest_lost_its_name_is_refused(trained, tmp_path):
    path = copy_of(
        trained["hypotheses"] / "weights.safetensors", tmp_path / "a.safetensors", metadata={"contents": "0"}
    )
    with pytest.raises(WeightsError, match="is damaged: none has a text contents"):
        open_checkpoint(path)


def test_checkpoints_hold_no_pickles(trained):
    for folder in trained.values():
        tensors = {path for path in folder.iterdir() if path.suffix == ".safetensors"}
        assert {path.suffix for path in folder.iterdir()} - {".safetensors"} <= {".toml", ".csv", ".png", ".json"}
        assert {"weights.safetensors", "state.safetensors"} <= {path.name for path in tensors}
        for file in tensors:
            assert safetensors.torch.load(file.read_bytes())


def test_a_record_that_asks_for_a_gigantic_model_is_refused_before_it_is_made(trained, tmp_path):
    text = recipe_to_toml(HYPOTHESES).replace("hypotheses = 4", "hypotheses = 1000000000")
    path = copy_of(trained["hypotheses"] / "weights.safetensors", tmp_path / "a.safetensors", metadata={"recipe": text})
    with pytest.raises(WeightsError, match="hypotheses: expected 1 to 10000, found 1000000000"):
        open_checkpoint(path)


def test_what_is_no_file_of_a_checkpoint_is_refused_without_waiting(tmp_path):
    for name, put in {
        "fifo": os.mkfifo,
        "device": lambda path: path.symlink_to("/dev/zero"),
        "folder": Path.mkdir,
    }.items():
        (tmp_path / name).mkdir()
        put(tmp_path / name / "weights.safetensors")
        for path in (tmp_path / name, tmp_path / name / "weights.safetensors"):
            with pytest.raises(WeightsError, match=r"is no regular file|is a folder|there is no such checkpoint"):
                open_checkpoint(path)
    (tmp_path / "other").mkdir()
    assert trained_networks(tmp_path, SimpleNamespace(train_fingerprint="", image_size=())) == []
    with pytest.raises(WeightsError, match="there is no such checkpoint"):
        open_checkpoint(tmp_path / "other")


def test_record_and_weights_of_a_checkpoint_are_those_of_one_file(trained, tmp_path, monkeypatch):
    """It is replaced by another's as soon as it is opened; and the digest is of what was read."""
    whole, other = (trained[name] / "weights.safetensors" for name in ("hypotheses", "classifier"))
    path = Path(shutil.copy(whole, tmp_path / "a.safetensors"))
    open_file = os.open

    def open_and_replace(name, *rest, **options):
        descriptor = open_file(name, *rest, **options)
        if Path(name) == path:
            Path(shutil.copy(other, tmp_path / "b.safetensors")).replace(path)
        return descriptor

    monkeypatch.setattr(os, "open", open_and_replace)
    opened = open_checkpoint(path)
    assert opened.record.name == "hypotheses"
    assert opened.sha256 == hashlib.sha256(whole.read_bytes()).hexdigest()
    assert torch.equal(opened.model.state_dict()["output.bias"], read_weights(whole)["output.bias"])
    assert path.read_bytes() == other.read_bytes()
