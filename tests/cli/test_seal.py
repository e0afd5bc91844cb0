"""`seal` and `score --secret`: a sealed test by its commands, with real Blender, and what they refuse in one line."""

import re
import shutil
import signal
import subprocess
import time

import numpy as np
import pytest
from command_line import INTERRUPTIBLE, contents, symsol
from sealed_tests import IMAGES, everything_in, sealed_test

import symsol_annot
from symsol_annot.bench.submission import write_hypotheses
from symsol_annot.rotations.so3 import uniform_rotations
from symsol_annot.sealing.secret import read_secret
from symsol_annot.sets.dataset import load


def hypotheses_about(folder, path):
    images = load(folder)
    rotations = uniform_rotations(2 * len(images), np.random.default_rng(0)).reshape(-1, 2, 3, 3)
    write_hypotheses(path, images, rotations, method="blind", progress=False)
    return path


def good(done):
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return done.stdout


def refused(done, code=1):
    """The one line of a refusal."""
    assert (done.returncode, done.stdout) == (code, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith("Error: ")
    return line


@pytest.mark.blender
@pytest.mark.parametrize("name", ["cylO", "tetX"])
def test_a_test_is_sealed_rendered_scored_revealed_and_checked(name, tmp_path):
    new = good(symsol("seal", "new", "--object", name, "--images", "12", "--size", "64", cwd=tmp_path))
    digest = re.search(r"digest (\w{64})", new)[1]
    folder = tmp_path / "sealed" / name
    assert {path.name for path in folder.iterdir()} == {"secret.json", "commitment.json"}
    render = good(symsol("seal", "render", f"sealed/{name}", "--workers", "1", cwd=tmp_path))
    public = shutil.copytree(folder / "public", tmp_path / "images")
    images, labelled = symsol_annot.load(public), symsol_annot.load(folder / "labelled")
    assert images.fingerprint in render
    assert images.fingerprint != labelled.fingerprint
    assert images[11].image.shape == (64, 64, 3)
    assert len(labelled[11].symmetry_set) >= 1
    assert "commitment   " + digest in good(symsol("info", public)).splitlines()
    assert "whole and consistent" in good(symsol("verify", public))
    assert "0 faults" in good(symsol("verify", folder / "labelled", "--audit", "2"))
    preds = hypotheses_about(public, tmp_path / "preds.h5")
    assert "valid" in good(symsol("validate", preds, "--data", public))
    assert "is sealed" in refused(symsol("score", preds, "--data", public))
    table = good(symsol("score", preds, "--data", public, "--secret", folder / "secret.json"))
    assert f"{name}, test split, 12 images: blind" in table
    seed = re.search(r"^seed +(\w{32})$", good(symsol("seal", "reveal", folder)), flags=re.MULTILINE)[1]
    words = ("seal", "check", public, "--digest", digest, "--workers", "1")
    checked = good(symsol(*words, "--seed", seed, cwd=tmp_path))
    assert "1 of 1 are the same to the byte" in checked
    assert everything_in(tmp_path / "checked" / name) == everything_in(folder)
    assert table == good(
        symsol("score", preds, "--data", public, "--secret", tmp_path / "checked" / name / "secret.json")
    )
    flipped = f"{int(seed, 16) ^ 1:032x}"
    assert "does not fit the commitment" in refused(symsol(*words, "--seed", flipped, "--out", "no", cwd=tmp_path))
    assert not (tmp_path / "no").exists()
    again = symsol("seal", "new", "--object", name, "--images", "12", "--size", "64", cwd=tmp_path)
    assert "nothing was touched" in refused(again)


@pytest.mark.blender
def test_a_render_that_is_interrupted_is_resumed(tmp_path):
    good(symsol("seal", "new", "--object", "tetX", "--images", "128", "--size", "64", "--out", tmp_path))
    folder = tmp_path / "tetX"
    words = ["seal", "render", str(folder), "--workers", "1"]
    process = subprocess.Popen([*INTERRUPTIBLE, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while process.poll() is None and not list(folder.glob("labelled/*.h5")):
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate()
    assert process.returncode == 130, said
    assert "re-running the command resumes it" in said
    there = {path.name: path.stat().st_mtime_ns for path in folder.glob("labelled/*.h5")}
    assert 1 <= len(there) < 8
    assert {path.name for path in folder.iterdir()} == {"secret.json", "commitment.json", "labelled"}
    good(symsol(*words))
    assert {name: (folder / "labelled" / name).stat().st_mtime_ns for name in there} == there
    assert len(symsol_annot.load(folder / "public")) == 128


# What is refused, and what else is said


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A sealed test of the numpy renderer, and predictions about it."""
    folder = sealed_test(tmp_path_factory.mktemp("sealed") / "tetX")
    hypotheses_about(folder / "public", folder.parent / "preds.h5")
    return folder


def test_files_with_figures_of_single_images_are_warned_of(made, here, tmp_path):
    words = ("score", made.parent / "preds.h5", "--data", made / "public", "--secret", made / "secret.json")
    assert here(*words).stderr == ""
    warned = here(*words, "--json", tmp_path / "scores.json")
    assert warned.returncode == 0
    assert "send back the table alone" in warned.stderr


def test_a_sealed_set_in_a_folder_of_sets_is_found_by_what_predictions_say(made, here):
    done = here("score", made.parent / "preds.h5", "--data", made, "--secret", made / "secret.json")
    assert f"tetX, test split, {IMAGES} images: blind" in done.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["seal", "render", "TMP"],
            "secret.json: cannot be read: No such file or directory; a sealed test is",
        ),
        (["seal", "reveal", "TMP"], "secret.json: cannot be read"),
        (["seal", "check", "LABELLED", "--seed", "0" * 32], "is no sealed set, so there is no seal to check"),
        (["seal", "check", "TMP", "--seed", "0" * 32], "holds no manifest.json"),
        (["seal", "check", "PUBLIC", "--seed", "0" * 32], "does not fit the commitment, whose digest is"),
        (["seal", "check", "PUBLIC", "--seed", "0" * 32, "--digest", "0" * 64], "was published before"),
        (["score", "PREDS", "--data", "PUBLIC"], "is sealed, so predictions about it are scored by whoever has its"),
        (["score", "PREDS", "--data", "PUBLIC", "--secret", "TMP/x.json"], "x.json: cannot be read: No such file"),
        (
            ["score", "PREDS", "--data", "PUBLIC", "--secret", "PUBLIC/commitment.json"],
            "is no file 'symsol-annot",
        ),
        (["queries", "PUBLIC", "--out", "TMP/q.h5"], "the test split is sealed"),
        (["reference", "PUBLIC", "--out", "TMP/reference"], "the test split is sealed"),
        (["gallery", "PUBLIC", "--out", "TMP/gallery"], "the test split is sealed"),
        (["plot", "sets", "PUBLIC", "--out", "TMP/sets.png"], "is sealed"),
        (["verify", "PUBLIC", "--repair"], "is sealed, so it can be drawn again by whoever has its secret alone"),
    ],
    ids=lambda value: " ".join(value[:2]) if isinstance(value, list) else "",
)
def test_each_is_refused_in_a_line_and_no_file_is_written(made, here, tmp_path, words, said):
    folder = shutil.copytree(made, tmp_path / "tetX")
    if "--repair" in words:
        next((folder / "public").glob("*.h5")).unlink()
    empty = tmp_path / "empty"
    empty.mkdir()
    places = {
        "TMP": empty,
        "LABELLED": folder / "labelled",
        "PUBLIC": folder / "public",
        "PREDS": made.parent / "preds.h5",
    }
    before = everything_in(folder)

    def place(word):
        name, slash, rest = word.partition("/")
        return f"{places[name]}{slash}{rest}" if name in places else word

    assert said in refused(here(*map(place, words)))
    assert everything_in(folder) == before
    assert [path for path in empty.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize("seed", ["", "123", "0" * 33, "g" * 32, "-" + "0" * 31])
def test_a_seed_of_other_digits_is_a_wrong_command_line(made, here, seed):
    done = here("seal", "check", made / "public", "--seed", seed)
    assert done.returncode == 2
    assert f"expected 32 hexadecimal digits, found {seed!r}" in done.stderr


def test_a_sealed_set_is_not_rendered_into_nor_published_as_a_set(made, here, tmp_path):
    public = shutil.copytree(made / "public", tmp_path / "data/tetX")
    before = contents(public)
    done = here("render", "--object", "tetX", "--train", "0", "--test", str(IMAGES), "--out", tmp_path / "data")
    assert (done.returncode, "already holds another set; nothing was touched" in done.stderr) == (1, True)
    done = here("publish", tmp_path / "data", "--out", tmp_path / "bundle", "--author", "A", "--title", "T")
    assert done.returncode == 1
    assert contents(public) == before


def test_info_names_the_seed_of_the_labelled_set_as_it_is_revealed(made, here):
    seed = read_secret(made / "secret.json").seed_hex
    assert f"seed {seed}" in here("info", made / "labelled").stdout
    assert seed in here("seal", "reveal", made).stdout
