"""A refusal says the line that mends it: who does what the line says has a file that scores as the truth does."""

import json
import re
import shutil

import h5py
import numpy as np
import pytest
from bench_sets import small_set
from made_sets import make_set
from scipy.spatial.transform import Rotation

import symsol_annot
from symsol_annot.bench.predictions.predictions_reader import open_predictions
from symsol_annot.bench.predictions.truth import find_set, read_subject
from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import DataError, PredictionsError
from symsol_annot.rotations.so3 import quat_wxyz_to_rotation, rotation_to_quat_wxyz

IMAGES = 12


@pytest.fixture(scope="module")
def few_images(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("data"), "tetX", IMAGES)


def poses(R):
    made = np.zeros((*R.shape[:-2], 4, 4))
    made[..., :3, :3], made[..., 3, 3] = R, 1.0
    return made


def rotation_vectors(R):
    return Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(*R.shape[:-2], 3)


FORMS = {  # what somebody has instead of (N, M, 3, 3), and what stands before the line that mends it
    "4x4 poses": (poses, "these are 4x4 poses: write"),
    "one pose per image": (lambda R: poses(R[:, 0]), "one per image: write"),
    "one rotation per image": (lambda R: R[:, 0], "this is one rotation per image: write"),
    "nine entries": (lambda R: R.reshape(IMAGES, -1, 9), "row by row: write"),
    "nine entries of one": (lambda R: R[:, 0].reshape(IMAGES, 9), "row by row: write"),
    "rotation vectors": (rotation_vectors, "import Rotation`, write"),
    "one rotation vector": (lambda R: rotation_vectors(R[:, 0]), "import Rotation`, write"),
    "quaternions": (rotation_to_quat_wxyz, "quat_wxyz_to_rotation`, write"),
    "one quaternion": (lambda R: rotation_to_quat_wxyz(R[:, 0]), "quat_wxyz_to_rotation`, write"),
    "scalar last": (lambda R: np.roll(rotation_to_quat_wxyz(R), -1, axis=-1), "where the scalar is first,"),
    "two columns": (lambda R: np.concatenate([R[..., 0], R[..., 1]], axis=-1), "complete them,"),
    "two columns of one": (lambda R: np.concatenate([R[:, 0, :, 0], R[:, 0, :, 1]], axis=-1), "complete them,"),
    "float16": (lambda R: R.astype(np.float16), "project what was rounded:"),
    "rounded to float16": (lambda R: R.astype(np.float16).astype(np.float32), "project what was rounded:"),
    "axes swapped": (lambda R: R.swapaxes(0, 1), "the first axis is the images: write"),
}


def line_after(message, words):
    """The code that follows on words in a message."""
    found = message[message.index(words) + len(words) :].strip()
    return re.split(r" where |; Euler| \(axis|: rows? \d|$", found, maxsplit=1)[0].split(", quat_wxyz")[0]


def done_as_said(line, given):
    names = dict.fromkeys(("R", "x", "poses"), given)
    names |= {"np": np, "Rotation": Rotation, "quat_wxyz_to_rotation": quat_wxyz_to_rotation}
    if re.match(r"\w+(, \w+)* = ", line):
        exec(line, names)
        return names["R"]
    return eval(line, names)


def written(path, dataset, **columns):
    with h5py.File(path, "w") as f:
        f.attrs.update(format="symsol-annot predictions", format_version=1, method="mine")
        f.attrs.update(object=dataset.object, split="test", fingerprint=dataset.fingerprint)
        f["image_index"] = range(len(dataset))
        for name, column in columns.items():
            f[name] = column
    return path


@pytest.mark.parametrize("form", FORMS)
def test_who_does_what_the_line_says_has_the_true_rotations_scored(form, few_images, tmp_path):
    make, words = FORMS[form]
    labels = few_images.labels()
    true = np.stack([labels.symmetry_set(i)[[0, 1, 2, 0, 1]] for i in range(IMAGES)])
    wrong = make(true)
    with pytest.raises(PredictionsError) as refused:
        score_file(written(tmp_path / "wrong.h5", few_images, hypotheses=wrong), few_images.folder)
    mended = done_as_said(line_after(str(refused.value), words), wrong)
    scores = score_file(written(tmp_path / "right.h5", few_images, hypotheses=mended), few_images.folder)
    assert scores.tracks["hypotheses"].figures["all"]["precision_mean_error_rad"].value < 1e-3


def test_probabilities_in_place_of_their_logarithms_are_called_so(few_images, tmp_path):
    path = tmp_path / "preds.h5"
    write_density(path, few_images, lambda i, R: 9.0 * R[:, 0, 0], method="mine", level=0, progress=False)
    with h5py.File(path, "r+") as f:
        logs = f["density_log_probabilities"][()]
        f["density_log_probabilities"][...] = np.exp(logs)
    with pytest.raises(PredictionsError, match=r"these look like probabilities: write np\.log\(p\)"):
        score_file(path, few_images.folder)
    with h5py.File(path, "r+") as f:
        f["density_log_probabilities"][...] = np.log(f["density_log_probabilities"][()])
    score_file(path, few_images.folder)


def test_logits_in_place_of_probabilities_are_called_so(few_images, tmp_path):
    path = tmp_path / "preds.h5"
    write_classifier(path, few_images, lambda i, R: 0.5 + 0.4 * R[:, 0, 0], method="mine", level=0, progress=False)
    with h5py.File(path, "r+") as f:
        f["query_probability"][...] = np.full(f["query_probability"].shape, -3.0)
    with pytest.raises(PredictionsError, match=r"logits become probabilities by 1 / \(1 \+ np\.exp\(-x\)\)"):
        score_file(path, few_images.folder)


@pytest.mark.parametrize("floor", [0.0, 1.0, -1.0, np.nan, "1e-9"])
def test_a_density_floor_is_between_0_and_1_or_not_there(floor, few_images, tmp_path):
    path = tmp_path / "preds.h5"
    write_density(path, few_images, lambda i, R: R[:, 0, 0], method="mine", level=0, progress=False)
    with h5py.File(path, "r+") as f:
        f.attrs.pop("density_floor", None)
    assert "density_floor" not in score_file(path, few_images.folder).tracks["density"].facts
    with h5py.File(path, "r+") as f:
        f.attrs["density_floor"] = 1e-9
    assert score_file(path, few_images.folder).tracks["density"].facts["density_floor"] == 1e-9
    with h5py.File(path, "r+") as f:
        f.attrs["density_floor"] = floor
    with pytest.raises(PredictionsError, match="'density_floor': expected"):
        score_file(path, few_images.folder)


@pytest.mark.parametrize(
    ("name", "save", "words"),
    [
        (
            "p.npy",
            np.save,
            r"is an array of NumPy's, .* symsol_annot\.load\('.*tetX'\), np\.load",
        ),
        ("p.npz", lambda path, R: np.savez(path, R=R), r"is a zip, as np\.savez writes, .*np\.load\('p\.npz'\)\['R'\]"),
        (
            "p.pt",
            lambda path, R: path.write_bytes(b"PK\x03\x04..."),
            r"is a file of PyTorch's, .*torch\.load\('p\.pt'\)",
        ),
        ("p.pkl", lambda path, R: path.write_bytes(b"\x80\x04..."), "is a pickle"),
        (
            "p.json",
            lambda path, R: path.write_text(json.dumps({"format": "symsol-annot scores"})),
            "is a file of scores, .*`symsol-annot compare` takes scores",
        ),
    ],
)
def test_a_file_of_another_kind_is_named_with_what_makes_predictions_of_it(name, save, words, few_images, tmp_path):
    save(tmp_path / name, few_images.labels().rotation[:, None])
    with pytest.raises(PredictionsError, match=f"(?s){words}"):
        score_file(tmp_path / name, few_images.folder.parent)


def test_the_line_for_an_array_of_numpys_writes_predictions(few_images, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save("R.npy", few_images.labels().rotation[:, None])
    with pytest.raises(PredictionsError) as refused:
        score_file("R.npy", str(few_images.folder.parent))
    line = re.search(r"write_hypotheses\(.*?method='mine'\)", str(refused.value))[0]
    exec(line, {"write_hypotheses": write_hypotheses, "symsol_annot": symsol_annot, "np": np})
    scores = score_file("preds.h5", str(few_images.folder.parent))  # paths as text
    assert scores.tracks["hypotheses"].figures["all"]["accuracy_at_1_deg"].value == 1.0


@pytest.mark.parametrize("whose", ["the whole set's", "the train split's"])
def test_a_fingerprint_of_the_same_set_is_called_so_and_the_line_gives_the_splits(whose, tmp_path):
    make_set(tmp_path / "data", "tetX", train=2, test=4, size=16)
    few_images = symsol_annot.load(tmp_path / "data" / "tetX")
    manifest = few_images.manifest
    path = written(tmp_path / "preds.h5", few_images, hypotheses=few_images.labels().rotation[:, None])
    with h5py.File(path, "r+") as f:
        is_whole = whose == "the whole set's"
        f.attrs["fingerprint"] = manifest.fingerprint if is_whole else manifest.split_fingerprint("train")
    with pytest.raises(PredictionsError, match=f"that is {whose}, where the test split's belongs") as refused:
        score_file(path, few_images.folder)
    line = re.search(r"f\.attrs\[.*fingerprint$", str(refused.value), re.MULTILINE)[0]
    with h5py.File(path, "r+") as f:
        exec(line, {"f": f, "symsol_annot": symsol_annot})
    score_file(path, few_images.folder)


def test_a_missing_attribute_or_index_comes_with_the_line_that_writes_it(few_images, tmp_path):
    path = written(tmp_path / "preds.h5", few_images, hypotheses=few_images.labels().rotation[:, None])
    with h5py.File(path, "r+") as f:
        del f.attrs["fingerprint"], f["image_index"]
    with pytest.raises(PredictionsError) as refused:
        score_file(path, few_images.folder)
    lines = re.findall(r"f(?:\.attrs)?\['\w+'\] = (?:range\(\d+\)|'\w+')", str(refused.value))
    with h5py.File(path, "r+") as f:
        for line in lines:
            exec(line, {"f": f})
    score_file(path, few_images.folder)


def test_images_counted_from_1_are_told_so(few_images, tmp_path):
    path = written(tmp_path / "preds.h5", few_images, hypotheses=few_images.labels().rotation[:, None])
    with h5py.File(path, "r+") as f:
        f["image_index"][...] = np.arange(1, IMAGES + 1)
    with pytest.raises(PredictionsError, match="images count from 0: subtract 1"):
        score_file(path, few_images.folder)


# Which set a file is about


@pytest.fixture
def preds(few_images, tmp_path):
    return written(tmp_path / "preds.h5", few_images, hypotheses=few_images.labels().rotation[:, None])


def test_a_set_is_found_by_its_object_whatever_its_folder_is_called(few_images, preds, tmp_path):
    shutil.copytree(few_images.folder, tmp_path / "data" / "renamed set")
    with open_predictions(preds, tmp_path / "data") as predictions:
        assert predictions.truth.folder == str(tmp_path / "data" / "renamed set")


def test_of_several_sets_of_an_object_the_one_is_taken_that_the_file_is_about(few_images, preds, tmp_path):
    data = tmp_path / "data"
    other = small_set(data / "elsewhere", "tetX", 8, seed=5)
    shutil.move(other.folder, data / "tetX")  # under the object's name
    shutil.copytree(few_images.folder, data / "older")
    score_file(preds, data)
    with open_predictions(preds, data) as predictions:
        assert predictions.truth.folder == str(data / "older")
    assert find_set(data, "tetX") == data / "tetX"


def test_sets_that_nothing_tells_apart_are_named(few_images, tmp_path):
    data = tmp_path / "data"
    data.mkdir()
    for name, seed in (("a", 5), ("b", 6)):
        shutil.move(small_set(tmp_path / name, "tetX", 8, seed=seed).folder, data / name)
    with pytest.raises(DataError, match=r"holds several sets of the object 'tetX'.*data/a, .*data/b"):
        read_subject(data, "tetX", "test", few_images.fingerprint)


def test_what_is_there_is_said_where_no_set_is_of_the_object(few_images, tmp_path):
    shutil.copytree(few_images.folder, tmp_path / "data" / "one")
    shutil.copytree(few_images.folder, tmp_path / "data" / "two")
    (tmp_path / "data" / "two" / "manifest.json").write_text("{")
    said = r"no set of the object 'cube': its sets are one \(tetX\), two \(its manifest cannot be read\)"
    with pytest.raises(DataError, match=said):
        find_set(tmp_path / "data", "cube")
    with pytest.raises(DataError, match="there is no such folder"):
        find_set(tmp_path / "nowhere", "cube")
