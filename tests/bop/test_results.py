"""BOP's CSV scores as the same rotations in a predictions file do, and every fault of one is told with its line."""

import numpy as np
import pytest
from bench_sets import small_set

from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.bench.submission import write_hypotheses
from symsol_annot.bop.numbering import scene_and_image
from symsol_annot.bop.results import HEADER, read_results, write_results
from symsol_annot.errors import DataError
from symsol_annot.rotations.so3 import uniform_rotations

M = 3
IDENTITY = "1 0 0 0 1 0 0 0 1"
GOOD = f"1,0,1,0.5,{IDENTITY},0 0 400,-1"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("sets"), "tetX", images=12)


def csv_of(path, hypotheses, scores, obj_id=1, header=True, order=None):
    """Write (N, M, 3, 3) rotations and (N, M) scores as bop_toolkit's save_bop_results does."""
    lines = []
    for i in range(len(hypotheses)):
        scene_id, im_id = scene_and_image(obj_id, i)  # of one scene each
        for R, score in zip(hypotheses[i], scores[i], strict=True):
            R_text = " ".join(map(str, R.ravel().tolist()))
            lines.append(f"{scene_id},{im_id},{obj_id},{score},{R_text},0.0 0.0 400.0,0.1")
    lines = [lines[k] for k in (range(len(lines)) if order is None else order)]
    path.write_text("\n".join([*([HEADER] if header else []), *lines]))
    return path


def figures_of(path, dataset):
    (track,) = score_file(path, dataset.folder).tracks.values()
    return {(stratum, name): figure.value for stratum, found in track.figures.items() for name, figure in found.items()}


def hypotheses_near(dataset, rng):
    R = dataset.labels().rotation
    return np.concatenate([R[:, None], uniform_rotations(len(dataset) * (M - 1), rng).reshape(-1, M - 1, 3, 3)], axis=1)


@pytest.mark.parametrize("kind", ["scores", "alike", "shuffled"])
def test_a_csv_scores_as_a_predictions_file_does(dataset, tmp_path, kind):
    rng = np.random.default_rng(1)
    hypotheses = hypotheses_near(dataset, rng)
    scores = np.ones((len(dataset), M)) if kind == "alike" else rng.uniform(0.1, 1.0, (len(dataset), M))
    order = rng.permutation(len(dataset) * M) if kind == "shuffled" else None
    path = csv_of(tmp_path / "mine.csv", hypotheses, scores, order=order)
    missing = write_results(
        tmp_path / "csv.h5", dataset, read_results(path, len(dataset)), method="mine", fill_missing=False
    )
    weights = None if kind == "alike" else scores
    write_hypotheses(tmp_path / "direct.h5", dataset, hypotheses, method="mine", weights=weights)
    found, expected = (figures_of(tmp_path / name, dataset) for name in ("csv.h5", "direct.h5"))
    assert missing == 0
    assert found.keys() == expected.keys()
    assert len(found) > 20
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, abs=1e-6, nan_ok=True), name


def test_images_may_have_different_numbers_of_estimates(dataset, tmp_path):
    hypotheses = hypotheses_near(dataset, np.random.default_rng(2))
    scores = np.where(np.arange(M) <= np.arange(len(dataset))[:, None] % M, 1.0, 0.0)  # one, two or three count
    path = csv_of(tmp_path / "mine.csv", hypotheses, scores, header=False)
    write_results(tmp_path / "csv.h5", dataset, read_results(path, len(dataset)), method="mine", fill_missing=False)
    write_hypotheses(tmp_path / "direct.h5", dataset, hypotheses, method="mine", weights=scores)
    found, expected = (figures_of(tmp_path / name, dataset) for name in ("csv.h5", "direct.h5"))
    assert found == pytest.approx(expected, abs=1e-6, nan_ok=True)


def test_poses_of_other_objects_are_left_out_and_the_second_object_is_found(dataset, tmp_path):
    hypotheses = hypotheses_near(dataset, np.random.default_rng(3))
    path = csv_of(tmp_path / "mine.csv", hypotheses, np.ones((len(dataset), M)), obj_id=2)
    path.write_text(f"{path.read_text()}\n{GOOD}\n")
    results = read_results(path, len(dataset), obj_id=2, first_scene=2)
    assert (len(results.index), results.others) == (len(dataset) * M, 1)
    np.testing.assert_array_equal(results.rotation.reshape(hypotheses.shape), hypotheses)


def test_images_without_an_estimate_are_named_or_filled(dataset, tmp_path):
    (tmp_path / "mine.csv").write_text(GOOD)
    results = read_results(tmp_path / "mine.csv", len(dataset))
    with pytest.raises(DataError, match=r"11 of 12 images have no estimate .* images 1, 2, 3.* --fill-missing"):
        write_results(tmp_path / "out.h5", dataset, results, method="mine", fill_missing=False)
    assert not (tmp_path / "out.h5").exists()
    assert write_results(tmp_path / "out.h5", dataset, results, method="mine", fill_missing=True) == 11


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1,0,1,0.5", "expected 7 fields, scene_id,im_id,obj_id,score,R,t,time, found 4"),
        (f"x,0,1,1,{IDENTITY},0 0 4,-1", "scene_id: expected a whole number, found 'x'"),
        (f"1,0.5,1,1,{IDENTITY},0 0 4,-1", "im_id: expected a whole number, found '0.5'"),
        (f"1,0,1,nan,{IDENTITY},0 0 4,-1", "score: expected a finite number, found 'nan'"),
        (f"1,0,1,-1,{IDENTITY},0 0 4,-1", "score -1: scores become weights, which are at least 0; --alike"),
        ("1,0,1,1,1 0 0 0 1 0 0 0,0 0 4,-1", "R: expected 9 finite numbers with spaces between"),
        (f"1,0,1,1,{IDENTITY},0 inf 4,-1", "t: expected 3 finite numbers"),
        ("1,0,1,1,2 0 0 0 1 0 0 0 1,0 0 4,-1", r"R is no rotation: .* off by 3 \(allowed 0.0001\)"),
        ("1,0,1,1,-1 0 0 0 1 0 0 0 1,0 0 4,-1", "R is no rotation"),
        (f"1,12,1,1,{IDENTITY},0 0 4,-1", "im_id 12 is image 12, and the split has 12 images"),
        (f"0,0,1,1,{IDENTITY},0 0 4,-1", "scene_id 0: the object's scenes begin with 1, as --first-scene says"),
    ],
)
def test_each_fault_is_told_with_its_line(tmp_path, line, words):
    (tmp_path / "mine.csv").write_text(f"{HEADER}\n{GOOD}\n{line}\n")
    with pytest.raises(DataError, match=rf"mine.csv: 1 fault; docs/bop.md .*\n  - line 3: .*{words}"):
        read_results(tmp_path / "mine.csv", 12)


def test_all_faults_are_told_at_once_up_to_twenty(tmp_path):
    (tmp_path / "mine.csv").write_text("1,2\n" * 25)
    with pytest.raises(DataError) as refused:
        read_results(tmp_path / "mine.csv", 12)
    assert "25 faults" in str(refused.value)
    assert str(refused.value).endswith("- and 5 more")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "expected poses of object 1: the file has no poses"),
        (f"1001,0,2,1,{IDENTITY},0 0 4,-1".encode(), "has 1 poses of other objects; --obj-id says which is meant"),
        (b"\xff\xfe\x00", "is no text in UTF-8"),
    ],
)
def test_a_file_without_poses_is_refused(tmp_path, content, words):
    (tmp_path / "mine.csv").write_bytes(content)
    with pytest.raises(DataError, match=words):
        read_results(tmp_path / "mine.csv", 12)


def test_alike_takes_negative_scores(tmp_path):
    (tmp_path / "mine.csv").write_text(GOOD.replace("0.5", "-1"))
    assert read_results(tmp_path / "mine.csv", 12, alike=True).score.tolist() == [1.0]


def test_the_command_writes_a_file_that_scores(dataset, here, tmp_path):
    hypotheses = dataset.labels().rotation[:, None]
    path = csv_of(tmp_path / "mine_tetX-test.csv", hypotheses, np.ones((len(dataset), 1)))
    done = here("import-bop-results", path, "--data", dataset.folder, "--out", tmp_path / "preds.h5")
    assert (done.returncode, done.stdout) == (0, f"{tmp_path}/preds.h5: 12 estimates of 12 images\n"), done.stderr
    scored = here("score", tmp_path / "preds.h5", "--data", dataset.folder)
    assert scored.returncode == 0
    assert "mine_tetX-test" in scored.stdout
    missing = here("import-bop-results", tmp_path / "no.csv", "--data", dataset.folder, "--out", tmp_path / "x.h5")
    assert (missing.returncode, missing.stderr) == (
        1,
        f"Error: {tmp_path}/no.csv: cannot be read: No such file or directory\n",
    )
