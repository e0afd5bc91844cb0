"""The command `train`: from a recipe to predictions that are scored, and what it refuses in one message."""

import numpy as np
import pytest
import torch
from made_sets import make_set
from symsol_annot_cli.epoch_table import EpochTable
from tiny_training import NARROW
from volume_truths import made_truth

from symsol_annot.bench.models.training.checkpoints import open_checkpoint
from symsol_annot.bench.models.validation import classifier_figures, hypothesis_figures

torch.set_num_threads(1)

RECIPE_TOML = f"""
title = "tiny"
model = "hypotheses"
start = "random"
backbone = "{NARROW.name}"
hypotheses = 4
meta_loss = "wta"
embedded_loss = "cyclic-cosine"
batch_size = 8
epochs = 1
learning_rates = [1e-3]
milestones = []
validation_images = 4
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A folder of sets: tetX, of images so small that a training takes seconds."""
    folder = tmp_path_factory.mktemp("training") / "data"
    make_set(folder, "tetX", train=20, test=3, size=16, annotate="all")
    return folder


def test_train_predict_and_score_from_the_command_line(data, here, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.toml").write_text(RECIPE_TOML)
    done = here("train", "tiny.toml", "--data", data, "--device", "cpu")
    assert (done.returncode, done.stderr) == (0, "")  # no bar where there is no terminal
    assert done.stdout.startswith("A line per epoch: loss is its mean over the epoch, rate is the learning rate")
    (heading,) = [line for line in done.stdout.splitlines() if line.startswith("epoch ")]
    (figures,) = [line for line in done.stdout.splitlines() if line.startswith("  1/1 ")]
    assert len(heading.split()) == len(figures.split())
    assert "symsol-annot predict runs/tetX-tiny" in done.stdout
    again = here("train", "tiny.toml", "--data", data, "--device", "cpu")
    assert again.stdout.startswith("resumes after epoch 1 of 1")
    done = here("predict", "runs/tetX-tiny", "--data", data, "--device", "cpu", "--out", "preds.h5")
    assert (done.returncode, done.stderr) == (0, "")
    done = here("score", "preds.h5", "--data", data)
    assert done.stdout.startswith("tetX, test split, 3 images: tiny")


def test_batch_size_and_learning_rate_are_changed_on_the_command_line(data, here, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.toml").write_text(
        RECIPE_TOML.replace(
            "learning_rates = [1e-3]\nmilestones = []", "learning_rates = [1e-3, 1e-5]\nmilestones = [1]"
        ).replace("epochs = 1", "epochs = 2")
    )
    done = here("train", "tiny.toml", "--data", data, "--batch-size", "4", "--learning-rate", "2e-4")
    assert (done.returncode, done.stderr) == (0, "")
    recipe = open_checkpoint(tmp_path / "runs" / "tetX-tiny").record.recipe
    assert recipe.batch_size == 4
    assert recipe.learning_rates == pytest.approx((2e-4, 2e-6))
    assert "\n  2/2 " in done.stdout


def test_a_training_is_extended_logged_and_its_images_kept_from_the_command_line(data, here, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "tiny.toml").write_text(RECIPE_TOML + "input_size = 8\n")
    words = ("train", "tiny.toml", "--data", data, "--device", "cpu")
    assert here(*words, "--no-cache").returncode == 0
    assert not (tmp_path / "cache").exists()
    done = here(*words, "--epochs", "2", "--tensorboard", "--workers", "1")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("extended after epoch 1, from 1 epochs to 2\n")
    assert "tensorboard --logdir runs" in done.stdout
    assert len(list((tmp_path / "runs" / "tetX-tiny" / "tensorboard").iterdir())) == 1
    assert len(list((tmp_path / "cache" / "symsol-annot").iterdir())) == 2
    done = here(*words)
    assert (done.returncode, "--epochs 2 resumes it" in done.stderr) == (1, True)


def test_no_line_of_the_table_is_wider_than_a_terminal():
    labels = made_truth(1, np.random.default_rng(0)).labels
    rows = {
        "hypotheses": ("winners", "concentration", *hypothesis_figures(labels, np.eye(3)[None, None])),
        "classifier": ("is_frozen", *classifier_figures([(1, 1, 1)])),
        "mixture": ("log_likelihood_at_gt",),
        "a later one": ("a_figure_without_a_short_name",),
    }
    for names in rows.values():
        row = {"epoch": 1.0, "loss": 1.2345e-5, "learning_rate": 1.2345e-5, "images_per_second": 12345.6}
        row |= dict.fromkeys(names, 0.123456) | {"seconds": 12345.0, "processor_seconds": 1.0}
        table = EpochTable(row, 100)
        lines = [*table.heading(), table.line(row)]
        assert max(map(len, lines)) <= 80, lines
        assert len(lines[-1].split()) == len(lines[-2].split()) == len(row) - 1
    assert EpochTable(row, 100).line({**row, "loss": float("nan")}).split()[1] == "nan"


@pytest.mark.parametrize("name", ["..toml", "a b.toml", "..", "-x.toml", "tiny.v2.toml"])
def test_a_run_lies_in_runs_whatever_its_recipe_is_called(name, data, here, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if name != "..":
        (tmp_path / name).write_text(RECIPE_TOML)
    done = here("train", "--data", data, "--device", "cpu", "--", name)
    folders = [path for path in tmp_path.iterdir() if path.is_dir()]
    if name == "..":
        assert (done.returncode, folders) == (1, [])
        return
    assert (done.returncode, folders) == (0, [tmp_path / "runs"])
    assert [path.name for path in (tmp_path / "runs").iterdir()] == [f"tetX-{name.removesuffix('.toml')}"]
    assert open_checkpoint(tmp_path / "runs" / f"tetX-{name.removesuffix('.toml')}").record.is_finished


@pytest.mark.parametrize("name", ["a\nb.toml", "\x1b[2J.toml"])
def test_a_recipe_whose_name_could_act_on_a_terminal_is_refused(name, data, here, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text(RECIPE_TOML)
    done = here("train", name, "--data", data, "--device", "cpu")
    assert (done.returncode, "rename it" in done.stderr) == (1, True)
    assert "\x1b" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_the_command_lists_recipes(here):
    done = here("train", "--list")
    assert done.returncode == 0
    assert "small-wta" in done.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["no-such-recipe"], "no such file, and no built-in recipe of that name"),
        (["small-wta", "--data", "nowhere"], "nowhere: expected a set to train on, found none"),
        (["small-wta", "--object", "cube"], "holds no set of the object 'cube'"),
        (["small-wta"], "of which the recipe takes 200 for validation"),
        (["small-wta", "--validation-images", "0", "--device", "cuda:7"], "there is no 'cuda:7' here"),
        (["small-wta", "--batch-size", "70000"], "small-wta: batch_size: expected 2 to 65536, found 70000"),
        (["small-wta", "--learning-rate", "inf"], "small-wta: learning_rates: expected numbers above 0, found [inf"),
    ],
)
def test_train_refuses_in_one_message(words, said, data, here, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = words if "--data" in words else [*words, "--data", data]
    done = here("train", *words)
    assert done.returncode == 1
    assert said in done.stderr
    assert done.stderr.startswith("Error: ")
    assert list(tmp_path.iterdir()) == []


def test_train_refuses_a_set_without_a_train_split_and_several_without_a_name(data, here, tmp_path):
    make_set(tmp_path / "data", "tetX", test=2, size=16)
    done = here("train", "small-wta", "--data", tmp_path / "data", "--out", tmp_path / "run")
    assert (done.returncode, "has no split 'train'; it has test" in done.stderr) == (1, True)
    make_set(tmp_path / "data", "tet", test=2, size=16)
    done = here("train", "small-wta", "--data", tmp_path / "data", "--out", tmp_path / "run")
    assert (done.returncode, "several: tet, tetX; --object names one" in done.stderr) == (1, True)
    done = here("train", "small-wta", "--data", data / "tetX", "--object", "cube")
    assert (done.returncode, "is a set of tetX, not of cube" in done.stderr) == (1, True)
