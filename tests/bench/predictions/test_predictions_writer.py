"""A predictions file that is written: tracks are added or replaced, and a stopped call is resumed."""

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from made_sets import make_set
from methods import random_rotations
from written_predictions import (
    CELLS,
    IMAGES,
    LEVEL,
    METHOD,
    Interrupted,
    contents,
    every_track,
    left_beside,
    refuse_to_answer,
    write,
)

from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.bench.predictions.writing.submission import write_columns, write_hypotheses
from symsol_annot.errors import NotAnnotatedError, PredictionsError, SettingsError
from symsol_annot.sets.dataset import load
from symsol_annot.system.scratch import MARK_NAME


@pytest.mark.parametrize("order", [("hypotheses", "classifier", "density"), ("density", "classifier", "hypotheses")])
def test_tracks_are_added_in_any_order(alone, tetX, tmp_path, order):
    path = Path(shutil.copy(alone[order[0]], tmp_path / "preds.h5"))
    for track in order[1:]:
        write(track, path, tetX)
    columns, attributes = contents(path)
    assert left_beside(path) == []
    every_dataset = {name for track in TRACKS.values() for name in track.datasets}
    assert {"image_index", "hypothesis_weights", *columns} == {"image_index", *every_dataset}
    for track in order:
        expected, about = contents(alone[track])
        assert about.items() <= attributes.items()
        assert all(np.array_equal(columns[name], expected[name]) for name in expected)


def test_a_track_that_is_written_again_replaces_the_old_one_and_no_other(tetX, tmp_path):
    path = tmp_path / "preds.h5"
    write_hypotheses(path, tetX, random_rotations(), weights=np.ones((IMAGES, 3)), method=METHOD)
    write("density", path, tetX)
    density = contents(path)[0]["density_log_probabilities"]
    write_hypotheses(path, tetX, random_rotations(2), method=METHOD)
    columns, _ = contents(path)
    assert columns["hypotheses"].shape == (IMAGES, 2, 3, 3)
    assert "hypothesis_weights" not in columns  # which were of the old ones
    assert np.array_equal(columns["density_log_probabilities"], density)


def test_a_track_alone_in_its_file_may_be_written_again_on_another_grid(alone, tetX, tmp_path):
    path = Path(shutil.copy(alone["density"], tmp_path))
    write("density", path, tetX, level=1)
    assert contents(path)[1]["grid_level"] == 1


@pytest.mark.parametrize(
    ("track", "changes", "words"),
    [
        ("hypotheses", {"method": "another"}, rf'with another method: "{METHOD}"'),
        ("density", {"method": "another"}, rf'with another method: "{METHOD}"'),
        ("density", {"level": 1}, "with another grid_level: 0"),
    ],
)
def test_a_file_about_something_else_is_refused_at_once_and_left_as_it_is(tetX, written, track, changes, words):
    before = written.read_bytes()
    with pytest.raises(PredictionsError, match=words):
        write(track, written, tetX, refuse_to_answer, **changes)
    assert written.read_bytes() == before
    assert left_beside(written) == []


@every_track
def test_a_file_about_another_set_is_refused_at_once_and_left_as_it_is(another_tetX, written, track):
    before = written.read_bytes()
    with pytest.raises(PredictionsError, match="is there already, with another fingerprint"):
        write(track, written, another_tetX, refuse_to_answer)
    assert written.read_bytes() == before
    assert left_beside(written) == []


def test_a_file_that_became_another_while_it_was_asked_is_refused(tetX, another_tetX, tmp_path):
    path, other = tmp_path / "preds.h5", tmp_path / "other.h5"
    write_hypotheses(other, another_tetX, random_rotations(), method=METHOD)

    def meanwhile(i):
        if i == 7:
            shutil.copy(other, path)
        return random_rotations()[i]

    with pytest.raises(PredictionsError, match="with another fingerprint"):
        write_hypotheses(path, tetX, meanwhile, method=METHOD)
    assert contents(path)[1]["fingerprint"] == another_tetX.fingerprint


def edited(path, change):
    with h5py.File(path, "r+") as file:
        change(file)
    return path.read_bytes()


def reorder(file):
    for name in ("hypotheses", "query_probability", "image_index"):
        file[name][...] = file[name][...][::-1]


def drop_an_image(file):
    del file["image_index"]
    file["image_index"] = np.arange(IMAGES - 1)


def link_away(file):
    del file["grid_indices"]
    file["grid_indices"] = h5py.ExternalLink("/etc/passwd", "/x")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (reorder, "not in the images' order"),
        (drop_an_image, "not in the images' order"),
        (link_away, "'grid_indices' is a link into another file"),
    ],
)
def test_a_track_is_not_added_to_rows_of_another_order_or_to_other_files(tetX, written, change, words):
    before = edited(written, change)
    with pytest.raises(PredictionsError, match=words):
        write("density", written, tetX, refuse_to_answer)
    assert written.read_bytes() == before


def test_a_track_of_another_order_may_be_replaced_where_it_is_alone(alone, tetX, tmp_path):
    path = Path(shutil.copy(alone["hypotheses"], tmp_path))
    with h5py.File(path, "r+") as file:
        file["image_index"][...] = np.arange(IMAGES)[::-1]
    write("hypotheses", path, tetX)
    assert np.array_equal(contents(path)[0]["image_index"], np.arange(IMAGES))


def test_what_is_no_hdf5_file_is_not_overwritten(tetX, tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(PredictionsError, match="cannot be read as HDF5"):
        write("hypotheses", tmp_path / "thesis.txt", tetX, refuse_to_answer)
    with pytest.raises(PredictionsError, match="is no regular file"):
        write("hypotheses", tmp_path, tetX, refuse_to_answer)
    assert (tmp_path / "thesis.txt").read_text() == "mine"


@pytest.mark.parametrize("track", ["hypotheses", "density"])
def test_a_failed_write_leaves_the_old_file_and_names_its_faults(tetX, written, track):
    before = written.read_bytes()
    if track == "hypotheses":
        columns = {"hypotheses": random_rotations()}
        columns["hypotheses"][3, 1] = np.nan
        columns["hypotheses"][[5, 8], 0] *= -1
        faults = ["an infinite entry: row 3", r"no rotation .*: rows 5 \(hypothesis 0, .*determinant -1\), 8 \("]
    else:
        columns = {
            "density_offsets": np.arange(IMAGES + 1),
            "density_indices": np.full(IMAGES, CELLS),
            "density_log_probabilities": np.full(IMAGES, 0.5),
        }
        faults = [r"not in \[-1e\+06, 0\].*: rows 0, 1, 2, 3, 4 and 19 more", "an index outside 0 to 71"]
    level = {} if track == "hypotheses" else {"grid_level": LEVEL}
    with pytest.raises(PredictionsError) as refused:
        write_columns(written, tetX, track, columns, method=METHOD, **level)
    assert str(refused.value).startswith(f"{written}: 2 faults")
    for words in faults:
        assert refused.match(words)
    assert written.read_bytes() == before
    assert left_beside(written) == []


@pytest.mark.parametrize(
    ("track", "error"), [*((track, RuntimeError) for track in TRACKS), ("classifier", KeyboardInterrupt)]
)
def test_a_call_that_was_stopped_goes_on_with_what_is_left(alone, tetX, tmp_path, track, error):
    path = tmp_path / "preds.h5"
    with pytest.raises(error):
        write(track, path, tetX, Interrupted(track, 7, error))
    assert not path.exists()
    left = Interrupted(track)
    write(track, path, tetX, left, resume=True)
    assert sorted(set(left.asked)) == list(range(7, IMAGES))
    assert path.read_bytes() == alone[track].read_bytes()
    assert left_beside(path) == []


def test_tracks_that_were_stopped_do_not_disturb_each_other(tetX, tmp_path):
    path = tmp_path / "preds.h5"
    for track in ("hypotheses", "density"):
        with pytest.raises(RuntimeError):
            write(track, path, tetX, Interrupted(track, 7))
    left = Interrupted("hypotheses")
    write("hypotheses", path, tetX, left, resume=True)
    assert min(left.asked) == 7
    assert sorted(path.name for path in (tmp_path / "preds.h5.parts").iterdir()) == [MARK_NAME, "density"]


@pytest.mark.parametrize(
    ("track", "changes"),
    [
        ("hypotheses", {"method": "another"}),
        ("classifier", {"level": 1}),
        ("classifier", {"floor": 0.2}),
        ("density", {"floor": 1e-6}),
    ],
)
def test_answers_that_were_given_under_other_settings_are_refused_and_kept(tetX, tmp_path, track, changes):
    path = tmp_path / "preds.h5"
    with pytest.raises(RuntimeError):
        write(track, path, tetX, Interrupted(track, 7))
    (name, value) = next(iter(changes.items()))
    words = (
        rf"the beginning of other predictions \(.*{name} there .*, now {value!r}.*\); finish those, .* or delete the"
    )
    with pytest.raises(PredictionsError, match=words):
        write(track, path, tetX, refuse_to_answer, resume=True, **changes)
    assert len(list((tmp_path / "preds.h5.parts" / track).glob("*.answer"))) == 7


def test_writing_an_array_keeps_the_answers_of_a_stopped_call(tetX, tmp_path):
    path = tmp_path / "preds.h5"
    with pytest.raises(RuntimeError):
        write("hypotheses", path, tetX, Interrupted("hypotheses", 7))
    write_hypotheses(path, tetX, random_rotations(1), method=METHOD)
    assert len(list((tmp_path / "preds.h5.parts" / "hypotheses").glob("*.answer"))) == 7


def test_answers_about_another_set_are_refused(tetX, another_tetX, tmp_path):
    with pytest.raises(RuntimeError):
        write("hypotheses", tmp_path / "preds.h5", tetX, Interrupted("hypotheses", 7))
    with pytest.raises(PredictionsError, match="the beginning of other predictions"):
        write("hypotheses", tmp_path / "preds.h5", another_tetX, refuse_to_answer)


def test_nothing_is_shown_where_there_is_no_terminal(tetX, tmp_path, capfd):
    write("density", tmp_path / "preds.h5", tetX)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("rows", [slice(5), slice(1, None), slice(None, None, -1), slice(0, 0)])
@every_track
def test_a_slice_is_refused(tetX, tmp_path, track, rows):
    with pytest.raises(SettingsError, match="is a slice"):
        write(track, tmp_path / "preds.h5", tetX[rows], refuse_to_answer)
    assert list(tmp_path.iterdir()) == []


def test_a_slice_of_everything_is_the_split(alone, tetX, tmp_path):
    write("hypotheses", tmp_path / "preds.h5", tetX[:])
    assert (tmp_path / "preds.h5").read_bytes() == alone["hypotheses"].read_bytes()


@every_track
def test_a_split_without_symmetry_sets_is_refused_before_anything_is_asked(tmp_path, track):
    bare = load(make_set(tmp_path / "data", test=2, size=16, annotate="none"))
    with pytest.raises(NotAnnotatedError):
        write(track, tmp_path / "preds.h5", bare, refuse_to_answer)
    assert left_beside(tmp_path / "data") == []


@every_track
@pytest.mark.parametrize("method", [None, 7, "", "  ", "two\nlines", "nul\0", "\udc80", "x" * 201])
def test_a_method_without_a_printable_name_is_refused_before_anything_is_asked(tetX, tmp_path, track, method):
    with pytest.raises(
        SettingsError, match="method: expected 1 to 200 printable characters, not all of them spaces, found"
    ):
        write(track, tmp_path / "preds.h5", tetX, refuse_to_answer, method=method)
    assert list(tmp_path.iterdir()) == []
