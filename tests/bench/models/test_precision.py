"""What a GPU does otherwise, on a CPU: networks in bfloat16, and weights with an image's channels side by side."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from made_sets import make_set
from tiny_training import CLASSIFIER, CPU, HYPOTHESES

from symsol_annot.bench.models import devices
from symsol_annot.bench.models.inference import predict
from symsol_annot.bench.models.methods.classifier.method import ClassifierLearner
from symsol_annot.bench.models.methods.hypotheses.method import HypothesisLearner
from symsol_annot.bench.models.training import loop, refusals
from symsol_annot.bench.models.training.checkpoints import open_checkpoint, read_record
from symsol_annot.bench.models.training.loop import train
from symsol_annot.bench.models.weights.state_dicts import read_weights
from symsol_annot.sets.dataset import load

torch.set_num_threads(1)

SIZE = 32  # at 16 the last convolutions see one pixel, of which torch's CPU gives no right gradients in bfloat16
SCHEDULE = {"epochs": 8, "milestones": (6,)}
RECIPES = {
    "hypotheses": replace(HYPOTHESES, **SCHEDULE, meta_loss="wta", epochs_to_one=None),
    "classifier": replace(CLASSIFIER, **SCHEDULE),
}
FILES = ("weights.safetensors", "state.safetensors", "best.safetensors")


@pytest.fixture(scope="module", autouse=True)
def _as_on_a_gpu():
    def laid_out_for(device, model):
        return model.to(device, memory_format=torch.channels_last)

    with pytest.MonkeyPatch.context() as patch:
        for module in (devices, refusals):
            patch.setattr(module, "has_bfloat16", lambda _: True)
        patch.setattr(loop, "laid_out_for", laid_out_for)
        patch.setattr(loop, "plot_curve", lambda *_: None)
        yield


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("precision") / "data"
    make_set(folder, "tetX", train=20, test=3, size=SIZE, annotate="all")
    return folder


@pytest.fixture(scope="module")
def images(data):
    return load(data / "tetX", "train")


@pytest.fixture(scope="module", params=RECIPES)
def trained(request, images, tmp_path_factory):
    """A training without a stop: of which recipe, and its folder."""
    folder = tmp_path_factory.mktemp("runs") / request.param
    train(RECIPES[request.param], images, folder, CPU, name=request.param)
    return request.param, folder


@pytest.fixture
def seen():
    """What kinds of layers computed, with the types that came out."""
    types = set()

    def look(layer, _, answer):
        types.add((type(layer).__name__, answer.dtype))
        assert not torch.backends.cudnn.allow_tf32  # which a GPU would compute instead of 32 bits

    with torch.nn.modules.module.register_module_forward_hook(look):
        yield types


def test_losses_fall_and_the_record_says_in_which_precision(trained):
    name, folder = trained
    record = read_record(folder / "weights.safetensors")
    losses = [row["loss"] for row in record.rows]
    assert np.mean(losses[-2:]) < 0.9 * np.mean(losses[:2]), name
    assert record.software["precision"] == "bfloat16"


def test_files_hold_finite_numbers_of_32_bits(trained):
    _, folder = trained
    for file in FILES:
        tensors = read_weights(folder / file)
        assert {tensor.dtype for tensor in tensors.values()} == {torch.float32, torch.int64}
        assert all(tensor.isfinite().all() for tensor in tensors.values())
        assert all(tensor.is_contiguous() for tensor in tensors.values())


def test_going_on_gives_the_weights_of_not_stopping(trained, images, tmp_path):
    name, folder = trained
    out, steps = tmp_path / "run", 0

    def stop(count):
        nonlocal steps
        steps += count
        if steps > 5 * 16:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(RECIPES[name], images, out, CPU, name=name, on_batch=stop)
    assert read_record(out / "state.safetensors").epochs_done == 5
    train(RECIPES[name], images, out, CPU, name=name)
    for file in FILES:
        ours, theirs = read_weights(out / file), read_weights(folder / file)
        assert set(ours) == set(theirs)
        assert [name for name in ours if not torch.equal(ours[name], theirs[name])] == []


@pytest.mark.parametrize("name", RECIPES)
def test_training_has_products_in_16_bits_answers_and_figures_in_32(name, images, tmp_path, seen, monkeypatch):
    recipe = replace(RECIPES[name], **({"frozen_epochs": 0} if name == "classifier" else {}))
    kind = {"hypotheses": HypothesisLearner, "classifier": ClassifierLearner}[name]
    evaluate, in_training, layouts = kind.evaluate, set(), set()

    def evaluated(self, *given):
        in_training.update(seen)
        seen.clear()
        layouts.update(
            layer.weight.is_contiguous(memory_format=torch.channels_last)
            for layer in self.model.modules()
            if isinstance(layer, torch.nn.Conv2d)
        )
        return evaluate(self, *given)

    monkeypatch.setattr(kind, "evaluate", evaluated)
    train(recipe, images, tmp_path / "run", replace(CPU, epochs=1), name=name)
    assert layouts == {True}
    assert ("Conv2d", torch.bfloat16) in in_training
    assert ("Conv2d", torch.float32) not in in_training
    whole = {"hypotheses": "HypothesisNetwork", "classifier": "SecondStage"}[name]
    answers = {"hypotheses": "Linear", "classifier": whole}[name]
    assert ("Linear", torch.bfloat16) in in_training
    assert (answers, torch.float32) in in_training
    assert (whole, torch.bfloat16) not in in_training
    assert ("Linear" if name == "classifier" else whole, torch.float32) in seen
    assert {dtype for _, dtype in seen} == {torch.float32}


def test_predictions_are_made_in_32_bits_and_depend_on_no_layout(trained, data, tmp_path, seen):
    _, folder = trained
    test_split, checkpoint = load(data / "tetX"), open_checkpoint(folder)
    predict(checkpoint, test_split, tmp_path / "preds.h5", torch.device("cpu"), level=0)
    assert "Conv2d" in {layer for layer, _ in seen}
    assert {dtype for _, dtype in seen} == {torch.float32}
