"""What an installation of the wheel has to be able to do, base and extras."""

import json
import re

_TRAIN = ["train", "small-rwta", "--data", "SAMPLE", "--epochs", "1", "--validation-images", "16"]
# The extra that a command needs, in the order in which they may be run.
NEEDS = [
    ("render", ["render", "--object", "tetX", "--train", "0", "--test", "2", "--size", "32", "--workers", "1"]),
    ("render", ["verify", "SAMPLE", "--audit", "1"]),
    ("cluster", ["render", "--object", "tetX", "--train", "0", "--test", "2", "--cluster", "tcp://127.0.0.1:9"]),
    ("plot", ["plot", "images", "SAMPLE", "--count", "2", "--out", "images.png"]),
    ("gallery", ["gallery", "SAMPLE", "--limit", "8", "--redrawn", "0"]),
    ("publish", ["publish", "SAMPLE", "--out", "bundle"]),
    ("bench", [*_TRAIN, "--out", "run"]),
    ("bench", ["predict", "run", "--data", "SAMPLE"]),
]
EXTRAS = tuple(dict.fromkeys(extra for extra, _ in NEEDS))
# What needs a second extra beside the first.
TOGETHER = [
    ("bench", "plot", ["plot", "losses", "--out", "losses.png"]),
    ("bench", "tensorboard", [*_TRAIN, "--out", "logged", "--tensorboard"]),
]
_NOBODY_THERE = "nobody answers"  # what Dask's executor says, as no scheduler is there
_TRUTH = """
import symsol_annot
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
test = symsol_annot.load_sample("tetX")
write_hypotheses("preds.h5", test, lambda i: test[i].symmetry_set, method="truth")
print(test.folder)
"""


def check_base(environment, folder):
    """Use an installation without extras, in an empty folder: load, look, verify, score."""
    said = environment.run("python", "-W", "error", "-c", _TRUTH, cwd=folder).stdout
    command, [sample] = "symsol-annot", _on_sample(environment, ["SAMPLE"])
    assert said.strip() == sample, f"load_sample's folder: expected {sample}, found {said}"
    for words, expected in (("info", "marking shows in 28 of 64"), ("verify", "whole and consistent")):
        told = environment.run(command, words, sample, cwd=folder).stdout
        assert expected in told, f"{words}: expected {expected!r}, found {told}"
    environment.run(command, "validate", "preds.h5", "--data", sample, cwd=folder)
    environment.run(command, "score", "preds.h5", "--data", sample, "--json", "scores.json", cwd=folder)
    figures = json.loads((folder / "scores.json").read_text())["objects"]["tetX"]["hypotheses"]["all"]
    assert figures["recall_mean_error_rad"]["value"] < 1e-6
    assert figures["precision_mean_error_rad"]["value"] < 1e-6


def check_refusal(environment, extra, words, folder):
    """A command whose extra is missing says which, in one line."""
    said = environment.run("symsol-annot", *_on_sample(environment, words), cwd=folder, expected=1).stderr
    assert len(said.splitlines()) == 1, said
    assert re.search(rf"pip install '(symsol-annot|\.)\[{extra}\]'", said), said


def check_extra(environment, wanted, folder):
    """The commands of an extra work where no other is installed."""
    ending = 1 if wanted == "cluster" else 0
    for words in [words for extra, words in NEEDS if extra == wanted]:
        done = environment.run("symsol-annot", *_on_sample(environment, words), cwd=folder, expected=ending)
        assert "pip install" not in done.stderr, done.stderr
        assert (_NOBODY_THERE in done.stderr) == (wanted == "cluster"), done.stderr


def check_together(environment, wheel, wanted, folder):
    """So do the commands that need it and another, once that is installed too."""
    for _, other, words in [row for row in TOGETHER if row[0] == wanted]:
        environment.pip("install", "--quiet", f"{wheel}[{other}]")
        environment.run("symsol-annot", *_on_sample(environment, words), cwd=folder)


def _on_sample(environment, words):
    sample = str(environment.packages / "symsol_annot" / "sample_data" / "tetX")
    return [sample if word == "SAMPLE" else word for word in words]
