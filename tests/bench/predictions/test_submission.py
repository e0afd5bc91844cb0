"""Writing predictions: what ends up in the file, how it is gone on with, and what is refused."""

import shutil
import tempfile
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import pytest
from bench_sets import SmallDisk, python, small_set
from hypothesis import given, settings
from hypothesis import strategies as st
from made_sets import make_set
from methods import random_rotations

from symsol_annot.bench.predictions.queries import Queries
from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.bench.predictions.writing.submission import (
    write_classifier,
    write_columns,
    write_density,
    write_hypotheses,
)
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import NotAnnotatedError, OutputError, PredictionsError, RotationError, SettingsError
from symsol_annot.rotations.grid import GridIndex, equivolumetric_grid, grid_size
from symsol_annot.sets.dataset import load
from symsol_annot.system.scratch import MARK_NAME

IMAGES, LEVEL, CELLS = 24, 0, 72
METHOD = "test's method"
NOBODY = 65534


@pytest.fixture(scope="module")
def tetX(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("sets"), "tetX", IMAGES)


@pytest.fixture(scope="module")
def another_tetX(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("other"), "tetX", IMAGES, seed=1)


def probability(i, R):
    """Of an image and rotations; nothing special."""
    return 0.5 + 0.5 * np.sin(7.0 * R[:, 0, 0] + 5.0 * R[:, 1, 2] + i)


def log_density(i, R):
    return 4.0 * R[:, 0, 0] + R[:, 2, 1] - 100.0 * i


def hypothesise(i):
    return random_rotations()[i]


def write(track, path, dataset, answer=None, *, method=METHOD, **options):
    """Write a track by its callable; `answer` is asked instead of the usual function."""
    if track == "hypotheses":
        write_hypotheses(path, dataset, answer or hypothesise, method=method, **options)
    elif track == "classifier":
        write_classifier(path, dataset, answer or probability, **{"method": method, "level": LEVEL, **options})
    else:
        write_density(path, dataset, answer or log_density, **{"method": method, "level": LEVEL, **options})


def usual(track):
    return {"hypotheses": hypothesise, "classifier": probability, "density": log_density}[track]


def contents(path):
    """The data sets and the attributes."""
    with h5py.File(path) as file:
        return {name: file[name][...] for name in file}, dict(file.attrs)


def rows_of(values, offsets):
    return [values[a:b] for a, b in pairwise(offsets)]


def left_beside(path):
    return sorted(p.name for p in path.parent.iterdir() if p.name != path.name)


every_track = pytest.mark.parametrize("track", list(TRACKS))


# --- what is in the file ---


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_an_array_is_in_the_file_as_it_was_given(tetX, tmp_path, dtype):
    hypotheses, weights = random_rotations().astype(dtype), np.random.default_rng(1).random((IMAGES, 3)).astype(dtype)
    write_hypotheses(tmp_path / "preds.h5", tetX, hypotheses, weights=weights, method=METHOD)
    columns, attributes = contents(tmp_path / "preds.h5")
    assert columns["hypotheses"].dtype == columns["hypothesis_weights"].dtype == dtype
    assert np.array_equal(columns["hypotheses"], hypotheses)
    assert np.array_equal(columns["hypothesis_weights"], weights)
    assert np.array_equal(columns["image_index"], np.arange(IMAGES))
    assert attributes == {
        "format": "symsol-annot predictions",
        "format_version": 1,
        "method": METHOD,
        "object": "tetX",
        "split": "test",
        "fingerprint": tetX.fingerprint,
    }
    assert left_beside(tmp_path / "preds.h5") == []


def test_a_callable_writes_the_bytes_that_its_array_does(tetX, tmp_path):
    write_hypotheses(tmp_path / "array.h5", tetX, random_rotations(), method=METHOD)
    write_hypotheses(tmp_path / "callable.h5", tetX, hypothesise, method=METHOD)
    assert (tmp_path / "array.h5").read_bytes() == (tmp_path / "callable.h5").read_bytes()


def test_images_with_fewer_hypotheses_are_padded_with_weight_0(tetX, tmp_path):
    given_ones = [random_rotations(7)[i, : 1 + i % 7] for i in range(IMAGES)]
    write_hypotheses(tmp_path / "preds.h5", tetX, given_ones.__getitem__, method=METHOD)
    columns, _ = contents(tmp_path / "preds.h5")
    assert columns["hypotheses"].shape == (IMAGES, 7, 3, 3)
    for row, weight, one in zip(columns["hypotheses"], columns["hypothesis_weights"], given_ones, strict=True):
        assert np.array_equal(weight, np.arange(7) < len(one))
        assert np.array_equal(row[: len(one)], one)


def test_images_of_two_precisions_are_stored_in_the_lower_one(tetX, tmp_path):
    off_by_less_than_a_float32_may = (random_rotations() * (1 + 3e-5)).astype(np.float32)
    write_hypotheses(
        tmp_path / "preds.h5",
        tetX,
        lambda i: off_by_less_than_a_float32_may[i] if i % 2 else hypothesise(i),
        method=METHOD,
    )
    stored = contents(tmp_path / "preds.h5")[0]["hypotheses"]
    assert stored.dtype == np.float32
    assert np.array_equal(stored[1::2], off_by_less_than_a_float32_may[1::2])
    assert np.array_equal(stored[::2], random_rotations()[::2].astype(np.float32))


@pytest.mark.parametrize("batch_size", [1, 50, 10**6])
def test_each_query_and_each_grid_rotation_is_asked_once_in_batches(tetX, tmp_path, batch_size):
    asked = [[] for _ in range(IMAGES)]

    def classify(i, R):
        asked[i].append(R.copy())
        R[:] = np.nan  # as whoever is asked may do
        return np.zeros(len(R))

    write("classifier", tmp_path / "preds.h5", tetX, classify, batch_size=batch_size)
    queries, rotation = Queries(tetX.fingerprint, tetX.symmetry_group), tetX.labels().rotation
    for i in range(IMAGES):
        assert max(map(len, asked[i])) <= batch_size
        expected = [queries.rotations(i, rotation[i]), equivolumetric_grid(LEVEL)]
        assert np.array_equal(np.concatenate(asked[i]), np.concatenate(expected))


def test_a_classifiers_answers_stand_where_its_rotations_were_asked(tetX, tmp_path):
    write("classifier", tmp_path / "preds.h5", tetX, floor=0.3, batch_size=50)
    columns, attributes = contents(tmp_path / "preds.h5")
    queries, rotation = Queries(tetX.fingerprint, tetX.symmetry_group), tetX.labels().rotation
    assert (attributes["floor"], attributes["grid_level"]) == (0.3, LEVEL)
    bounds = columns["grid_offsets"]
    listed, answers = rows_of(columns["grid_indices"], bounds), rows_of(columns["grid_probabilities"], bounds)
    for i in range(IMAGES):
        at_queries = probability(i, queries.rotations(i, rotation[i])).astype(np.float32)
        on_grid = probability(i, equivolumetric_grid(LEVEL)).astype(np.float32)
        assert np.array_equal(columns["query_probability"][i], at_queries)
        assert np.array_equal(listed[i], np.flatnonzero(on_grid > 0.3))
        assert np.array_equal(answers[i], on_grid[on_grid > 0.3])


EDGES = [  # an answer, and whether it is above the floor of 0.1
    (lambda R: np.zeros(len(R), dtype=np.float16), False),
    (lambda R: np.full(len(R), np.float32(0.1)), False),  # as the floor is; in float32 that is more than 0.1
    (lambda R: np.nextafter(np.full(len(R), np.float32(0.1)), np.float32(1)), True),
    (lambda R: [1] * len(R), True),
    (lambda R: R[:, 0, 0] < 2, True),  # yes or no
    (lambda R: np.full(len(R), 1.0 + 1e-12), True),  # which float32 rounds to 1
]


def test_answers_at_the_edges_are_answers(tetX, tmp_path):
    write("classifier", tmp_path / "preds.h5", tetX, lambda i, R: EDGES[i % len(EDGES)][0](R))
    listed = [CELLS * EDGES[i % len(EDGES)][1] for i in range(IMAGES)]
    assert np.array_equal(np.diff(contents(tmp_path / "preds.h5")[0]["grid_offsets"]), listed)


def densities(path):
    columns, _ = contents(path)
    bounds = columns["density_offsets"]
    return rows_of(columns["density_indices"], bounds), rows_of(columns["density_log_probabilities"], bounds)


def softmax(log_p):
    p = np.exp(log_p - log_p.max())
    return p / p.sum()


def test_a_density_is_made_to_add_up_to_1_and_unlisted_cells_keep_their_mass(tetX, tmp_path):
    floor = 0.01
    write("density", tmp_path / "preds.h5", tetX, floor=floor, batch_size=50)
    for i, (listed, log_p) in enumerate(zip(*densities(tmp_path / "preds.h5"), strict=True)):
        p = softmax(log_density(i, equivolumetric_grid(LEVEL)))
        assert 0 < len(listed) < CELLS
        assert np.array_equal(listed, np.flatnonzero(p > floor))
        assert np.allclose(np.exp(log_p), p[listed], rtol=1e-12, atol=0)
        assert 1.0 - np.exp(log_p).sum() == pytest.approx(p[p <= floor].sum(), abs=1e-12)


def test_a_density_is_listed_whole_and_adds_up_to_1(tetX, tmp_path):
    write("density", tmp_path / "preds.h5", tetX)
    for listed, log_p in zip(*densities(tmp_path / "preds.h5"), strict=True):
        assert len(listed) == CELLS
        assert np.exp(log_p).sum() == pytest.approx(1.0, abs=1e-5)  # which the format allows


def test_a_density_that_is_certain_gives_the_floor_to_every_other_cell(tetX, tmp_path):
    certain = [
        lambda i, cell: np.where(cell == i, 0.0, -np.inf),
        lambda i, cell: np.where(cell == i, 1e300, 0.0),
        lambda i, cell: np.where(cell < 2 + i, 0.0, -40.0),
    ]
    write("density", tmp_path / "preds.h5", tetX, lambda i, R: certain[i % 3](i, np.arange(len(R))))
    for i, (listed, log_p) in enumerate(zip(*densities(tmp_path / "preds.h5"), strict=True)):
        assert len(listed) == CELLS
        assert np.exp(log_p[: i + 1]).sum() > 0.0
        assert log_p.min() == pytest.approx(np.log(1e-300) if i % 3 < 2 else np.log(np.exp(-40) / (2 + i)), abs=0.01)


@given(
    seed=st.integers(0, 2**32), constant=st.floats(-1e6, 1e6), exponent=st.floats(-8, 3), floor=st.floats(-300, -0.01)
)
@settings(deadline=None, max_examples=100)
def test_what_a_density_file_says_of_a_cell_is_the_densitys_own_or_at_most_the_floor(seed, constant, exponent, floor):
    from symsol_annot.bench.predictions.writing.given_answers import listed_density

    log_p = constant + 10.0**exponent * np.random.default_rng(seed).normal(size=500)
    log_p = log_p - np.logaddexp.reduce(log_p)
    rows = listed_density(log_p, 10.0**floor)
    mass = np.exp(rows["density_log_probabilities"]).sum()
    if len(rows["density_indices"]) < 500:
        assert mass < 1.0
        rest = (1.0 - mass) / (500 - len(rows["density_indices"]))  # as docs/submission.md shares it
    else:
        assert mass == pytest.approx(1.0, abs=1e-5)
        rest = np.nan
    in_file = np.full(500, np.log(rest))
    in_file[rows["density_indices"]] = rows["density_log_probabilities"]
    is_above = log_p > floor * np.log(10.0)
    assert np.allclose(in_file[is_above], log_p[is_above], rtol=0, atol=0.01)
    assert (in_file[~is_above] <= floor * np.log(10.0) + 0.01).all()
    if exponent < 0:  # nothing is below the default floor
        assert np.allclose(listed_density(log_p, 1e-300)["density_log_probabilities"], log_p, rtol=0, atol=0.01)


def one_mode(labels, kappa):
    """A Bingham-like density around the first member of each set alone: it misses the others."""
    return lambda i, R: kappa * (np.einsum("nij,ij->n", R, labels.symmetry_set(i)[0]) - 3.0)


@pytest.mark.parametrize("kappa", [0.5, 8.0, 80.0])
def test_log_likelihood_of_a_file_is_the_densitys_own(tetX, tmp_path, kappa):
    level, labels = 2, tetX.labels()
    log_density = one_mode(labels, kappa)
    write_density(tmp_path / "preds.h5", tetX, log_density, method=METHOD, level=level)
    grid, own = GridIndex(level), []
    for i in range(IMAGES):
        log_p = log_density(i, grid.rotations)
        log_p = log_p - np.logaddexp.reduce(log_p)
        own.append(log_p[grid.nearest(labels.symmetry_set(i))].mean() + np.log(len(grid) / np.pi**2))
    scored = score_file(tmp_path / "preds.h5", tetX.folder).tracks["density"].figures["all"]["log_likelihood"].value
    assert scored == pytest.approx(np.mean(own), abs=0.01)


def test_a_density_file_says_its_floor_and_forgets_that_of_a_track_that_is_replaced(tetX, tmp_path):
    path = tmp_path / "preds.h5"
    write("density", path, tetX, floor=1e-6)
    assert contents(path)[1]["density_floor"] == 1e-6
    write("hypotheses", path, tetX)
    assert contents(path)[1]["density_floor"] == 1e-6
    write("density", path, tetX)
    assert contents(path)[1]["density_floor"] == 1e-300
    columns = {name: contents(path)[0][name] for name in TRACKS["density"].datasets}
    write_columns(path, tetX, "density", columns, method=METHOD, grid_level=LEVEL)
    assert "density_floor" not in contents(path)[1]  # nobody said which one these have


# --- several tracks in a file ---


@pytest.fixture(scope="module")
def alone(tetX, tmp_path_factory):
    """A file for each track."""
    folder = tmp_path_factory.mktemp("alone")
    for track in TRACKS:
        write(track, folder / f"{track}.h5", tetX)
    return {track: folder / f"{track}.h5" for track in TRACKS}


@pytest.fixture(scope="module")
def _two_tracks(alone, tetX, tmp_path_factory):
    path = Path(shutil.copy(alone["hypotheses"], tmp_path_factory.mktemp("two") / "preds.h5"))
    write("classifier", path, tetX)
    return path


@pytest.fixture
def written(_two_tracks, tmp_path):
    """A file with hypotheses and a classifier."""
    (tmp_path / "written").mkdir()
    return Path(shutil.copy(_two_tracks, tmp_path / "written"))


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


def refuse_to_answer(*_):
    pytest.fail("was asked")


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
    # a classifier's rows on the grid would have to be turned round too; that does not matter here


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


# --- stopping and going on ---


class Interrupted:
    """Answers as usual, until the image at which it fails; notes which images it was asked about."""

    def __init__(self, track, failing_at=None, error=RuntimeError):
        self._answer, self._failing_at, self._error, self.asked = usual(track), failing_at, error, []

    def __call__(self, i, *R):
        if i == self._failing_at:
            raise self._error("out of memory")
        self.asked.append(i)
        return self._answer(i, *R)


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


def test_a_damaged_answer_is_named_and_asked_for_again_once_it_is_deleted(tetX, tmp_path):
    path = tmp_path / "preds.h5"
    with pytest.raises(RuntimeError):
        write("classifier", path, tetX, Interrupted("classifier", 7))
    damaged = tmp_path / "preds.h5.parts" / "classifier" / "00000003.answer"
    whole = damaged.read_bytes()
    middle = len(whole) // 2
    for data in (b"", whole[:100], whole[:middle], whole[:middle] + b"\0" * 40 + whole[middle + 40 :], b"[]" * 50):
        damaged.write_bytes(data)
        with pytest.raises(PredictionsError, match=r"00000003\.answer.*\n.*is damaged .*delete it"):
            write("classifier", path, tetX, resume=True)
    damaged.unlink()
    again = Interrupted("classifier")
    write("classifier", path, tetX, again, resume=True)
    assert set(again.asked) == {3}


def test_nothing_is_shown_where_there_is_no_terminal(tetX, tmp_path, capfd):
    write("density", tmp_path / "preds.h5", tetX)
    assert capfd.readouterr() == ("", "")


# --- what is refused ---


@pytest.mark.parametrize("rows", [slice(5), slice(1, None), slice(None, None, -1), slice(0, 0)])
@every_track
def test_a_slice_is_refused(tetX, tmp_path, track, rows):
    with pytest.raises(SettingsError, match="is a slice"):
        write(track, tmp_path / "preds.h5", tetX[rows], refuse_to_answer)
    assert list(tmp_path.iterdir()) == []


def test_a_slice_of_everything_is_the_split(tetX, tmp_path):
    write("hypotheses", tmp_path / "preds.h5", tetX[:])
    assert (tmp_path / "preds.h5").exists()


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


NOT_HYPOTHESES = [
    (np.eye(3), SettingsError, r"expected float32 or float64 of shape \(m, 3, 3\).*found float64 of shape \(3, 3\)"),
    (np.zeros((0, 3, 3)), SettingsError, r"found float64 of shape \(0, 3, 3\)"),
    (np.zeros((10_001, 3, 3)), SettingsError, r"m from 1 to 10000, found float64 of shape \(10001, 3, 3\)"),
    (np.eye(3, dtype=int)[None], SettingsError, "found int64"),
    (np.eye(3, dtype=np.float16)[None], SettingsError, "found float16"),
    (None, SettingsError, "found object"),
    ([[1.0], [1.0, 2.0]], SettingsError, "expected an array of numbers"),
    (np.zeros((2, 4, 4)), RotationError, r"found \(2, 4, 4\)"),
    (np.tile([1.0, 0, 0, 0], (5, 1, 1)), RotationError, r"found \(5, 1, 4\)"),
    (np.full((1, 3, 3), np.nan), RotationError, "off by nan"),
    (-np.eye(3)[None], RotationError, "off by 2"),
    (np.stack([np.eye(3), 1.01 * np.eye(3)]), RotationError, r"1 of 2 matrices .* in row 1: .*\(allowed 0.0001\)"),
]


@pytest.mark.parametrize(("answer", "error", "words"), NOT_HYPOTHESES)
def test_what_is_no_hypotheses_is_refused_with_its_image_and_may_be_mended(tetX, tmp_path, answer, error, words):
    with pytest.raises(error, match=f"(?s)hypotheses of image 7.*{words}"):
        write("hypotheses", tmp_path / "preds.h5", tetX, lambda i: answer if i == 7 else hypothesise(i))
    left = Interrupted("hypotheses", 8)
    with pytest.raises(RuntimeError):
        write("hypotheses", tmp_path / "preds.h5", tetX, left, resume=True)
    assert left.asked == [7]


def replaced(cell, value):
    """An answer about image 7 that is wrong at one rotation."""
    return lambda R: np.where(np.arange(len(R)) == cell, value, 0.5)


NOT_ANSWERS = [
    (lambda R: np.zeros((len(R), 1)), r"asked about \d+ rotations, the answer has the shape \(\d+, 1\)"),
    (lambda R: np.zeros(len(R) - 1), "the answer has the shape"),
    (lambda R: 0.5, r"the answer has the shape \(\)"),
    (lambda R: None, "expected an array of numbers, found object"),
    (lambda R: ["a"] * len(R), "expected an array of numbers, found <U1"),
    (lambda R: np.zeros(len(R), dtype=complex), "found complex128"),
    (replaced(3, np.nan), "found nan"),
    (replaced(3, np.inf), "found inf"),
]
NOT_PROBABILITIES = [
    (replaced(0, 1.001), r"expected probabilities from 0 to 1, found 1\.001"),
    (replaced(70, -0.001), r"expected probabilities from 0 to 1, found -0\.001"),
    (replaced(3, -np.inf), "found -inf"),
]
NOT_LOG_DENSITIES = [(lambda R: np.full(len(R), -np.inf), "at least one of them finite, found -inf")]


@pytest.mark.parametrize(
    ("track", "answer", "words"),
    [("classifier", *case) for case in NOT_ANSWERS + NOT_PROBABILITIES]
    + [("density", *case) for case in NOT_ANSWERS + NOT_LOG_DENSITIES],
)
def test_what_is_no_answer_is_refused_with_its_image(tetX, tmp_path, track, answer, words):
    with pytest.raises(SettingsError, match=f"image 7: .*{words}"):
        write(track, tmp_path / "preds.h5", tetX, lambda i, R: answer(R) if i == 7 else np.full(len(R), 0.5))
    assert not (tmp_path / "preds.h5").exists()


@pytest.mark.parametrize(
    ("hypotheses", "error", "words"),
    [
        (5.0, SettingsError, "hypotheses: expected an array, found the number 5"),
        (None, SettingsError, "hypotheses: expected an array of numbers, found object"),
        ([[1.0], [1.0, 2.0]], SettingsError, "hypotheses: expected an array of numbers"),
        (np.zeros((IMAGES, 0, 3, 3)), PredictionsError, "M = 0: 1 to 10000"),
        (np.zeros((IMAGES, 3, 4)), PredictionsError, r"found f8 of shape \(24, 3, 4\)"),
        (random_rotations()[:-1], PredictionsError, rf"found f8 of shape \({IMAGES - 1}, 3, 3, 3\)"),
        (random_rotations().astype(np.float16), SettingsError, "expected float32 or float64 .* found float16"),
        (random_rotations() > 0, PredictionsError, "booleans"),
        (-random_rotations(), PredictionsError, "determinant -1"),
    ],
)
def test_an_array_that_is_no_hypotheses_is_refused(tetX, tmp_path, hypotheses, error, words):
    with pytest.raises(error, match=words):
        write_hypotheses(tmp_path / "preds.h5", tetX, hypotheses, method=METHOD)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        (np.ones((IMAGES, 2)), r"expected f4 or f8 of shape \(24, 3\), found f8 of shape \(24, 2\)"),
        (-np.ones((IMAGES, 3)), "not all finite and at least 0: rows 0, 1, 2, 3, 4 and 19 more"),
        (np.zeros((IMAGES, 3)), "has no positive one: rows 0"),
    ],
)
def test_weights_that_are_none_are_refused(tetX, tmp_path, weights, words):
    with pytest.raises(PredictionsError, match=words):
        write_hypotheses(tmp_path / "preds.h5", tetX, random_rotations(), weights=weights, method=METHOD)


def test_weights_belong_to_an_array(tetX, tmp_path):
    with pytest.raises(SettingsError, match="weights: belong to an array"):
        write("hypotheses", tmp_path / "preds.h5", tetX, refuse_to_answer, weights=np.ones((IMAGES, 3)))


@pytest.mark.parametrize(
    ("track", "options", "words"),
    [
        ("classifier", {"floor": -0.1}, "floor: expected 0 to 0.8, found -0.1"),
        ("classifier", {"floor": 0.81}, "floor: expected 0 to 0.8"),
        ("classifier", {"floor": float("nan")}, "floor: expected 0 to 0.8, found nan"),
        ("density", {"floor": 0.0}, "floor: expected at least 1e-300 and less than 1, found 0.0"),
        ("density", {"floor": 1.0}, "floor: expected at least 1e-300 and less than 1"),
        ("density", {"floor": float("nan")}, "floor: .*nan"),
        *[(track, {"level": level}, "level: expected 0 to 5") for track in TRACKS if track != "hypotheses"
          for level in (-1, 6, 1.5)],
        *[(track, {"batch_size": size}, "batch_size: expected at least 1") for track in TRACKS if track != "hypotheses"
          for size in (0, -1)],
    ],
)  # fmt: skip
def test_settings_that_make_no_file_are_refused_before_anything_is_asked(tetX, tmp_path, track, options, words):
    with pytest.raises(SettingsError, match=words):
        write(track, tmp_path / "preds.h5", tetX, refuse_to_answer, **options)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("track", "columns", "attributes", "words"),
    [
        ("hypothesis", {}, {}, "there is no track 'hypothesis'; tracks are hypotheses, classifier, density"),
        ("hypotheses", {"image_index": np.arange(IMAGES)}, {}, "image_index: not of the track 'hypotheses'"),
        ("density", {"hypotheses": np.eye(3)}, {}, "hypotheses: not of the track 'density', which has density_offsets"),
        ("classifier", {}, {"flor": 0.2}, "flor: not of the track 'classifier', which has .*floor"),
        ("density", {}, {"format": "mine"}, "format: not of the track"),
    ],
)
def test_columns_and_attributes_of_another_track_are_refused(tetX, tmp_path, track, columns, attributes, words):
    with pytest.raises(SettingsError, match=words):
        write_columns(tmp_path / "preds.h5", tetX, track, columns, method=METHOD, **attributes)


def test_all_that_a_track_lacks_is_said_at_once(tetX, tmp_path):
    with pytest.raises(PredictionsError) as refused:
        write_columns(
            tmp_path / "preds.h5",
            tetX,
            "classifier",
            {"grid_offsets": np.zeros(IMAGES, dtype=int)},
            method=METHOD,
            grid_level=0,
        )
    said = str(refused.value)
    for words in ("'query_probability' is missing", "'grid_indices' is missing", "'grid_probabilities' is missing"):
        assert words in said
    assert "'grid_offsets': expected i8 or i4 of shape (25), found i8 of shape (24,)" in said


# --- where nothing can be written ---


@pytest.mark.parametrize("given_as", ["array", "callable"])
def test_folders_on_the_way_are_made_and_a_file_in_the_way_is_named(tetX, tmp_path, given_as):
    hypotheses = random_rotations() if given_as == "array" else hypothesise
    write_hypotheses(tmp_path / "a" / "b" / "preds.h5", tetX, hypotheses, method=METHOD)
    assert (tmp_path / "a" / "b" / "preds.h5").exists()
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match=r"file.*cannot be written: .*is a file, not a folder"):
        write_hypotheses(tmp_path / "file" / "preds.h5", tetX, hypotheses, method=METHOD)
    with pytest.raises(OutputError, match="cannot be written: File name too long"):
        write_hypotheses(tmp_path / ("x" * 300), tetX, hypotheses, method=METHOD)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "file"]


UNPRIVILEGED = f"""
import os, sys
from pathlib import Path
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.sets.dataset import load
dataset = load(sys.argv[1])
rotation = dataset.labels().rotation[:, None]
if os.geteuid() == 0:  # root may write anywhere; everything is imported and open by now
    os.setgroups([]), os.setresgid(*[{NOBODY}] * 3), os.setresuid(*[{NOBODY}] * 3)
for hypotheses in (rotation, lambda i: rotation[i]):
    try:
        write_hypotheses(Path(sys.argv[2]) / "preds.h5", dataset, hypotheses, method="mine")
        print("finished")
    except Exception as error:
        print(type(error).__name__, error)
"""


@pytest.fixture
def locked_folder():
    """A folder that every user can reach, as pytest's own are not, and none but root write to."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o555)
    yield folder
    folder.chmod(0o755)
    shutil.rmtree(folder)


def test_a_folder_without_permission_is_an_error_that_says_so(tetX, locked_folder):
    done = python(UNPRIVILEGED, tetX.folder, locked_folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(done.stdout.splitlines()) == 2
    for line in done.stdout.splitlines():
        assert line.startswith(f"OutputError {locked_folder}")
        assert "no write permission" in line
    assert list(locked_folder.iterdir()) == []


ON_A_FULL_DISK = """
import sys
from methods import random_rotations
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.sets.dataset import load
from symsol_annot.errors import OutputError
hypotheses = random_rotations(30)
try:
    write_hypotheses(sys.argv[1], load(sys.argv[2]), lambda i: hypotheses[i], method="mine")
except OutputError as error:
    print(error)
"""


@pytest.fixture
def small_disk(tmp_path):
    folder = tmp_path / "disk"
    folder.mkdir()
    disk = SmallDisk(folder)
    yield disk
    disk.unmount()


# The answers about an image take 4 KiB, as the note of the settings and the folder's mark do; the file takes 60. So the
# disk fills up before the first answer, among the answers, or in the middle of the file.
@pytest.mark.parametrize(("kibibytes", "kept"), [(4, 0), (40, 8), (144, IMAGES)])
def test_a_full_disk_keeps_the_answers_and_the_process_and_the_same_call_goes_on(tetX, small_disk, kibibytes, kept):
    small_disk.resize(kibibytes)
    path = small_disk.folder / "preds.h5"
    done = python(ON_A_FULL_DISK, path, tetX.folder)
    assert (done.returncode, done.stderr) == (0, "")  # a file that HDF5 cannot finish would crash it at its end
    assert str(path) in done.stdout
    assert "the disk is full: make room, then run the same command again" in done.stdout
    assert not path.exists()
    assert not list(small_disk.folder.glob(".*"))
    asked = []
    hypotheses = random_rotations(30)
    small_disk.resize(1000)
    write_hypotheses(path, tetX, lambda i: asked.append(i) or hypotheses[i], method="mine", resume=kept > 0)
    assert asked == list(range(kept, IMAGES))
    assert np.array_equal(contents(path)[0]["hypotheses"], hypotheses)


def test_a_full_disk_leaves_the_old_file(tetX, small_disk):
    small_disk.resize(100)
    path = small_disk.folder / "preds.h5"
    write_hypotheses(path, tetX, random_rotations(1), method=METHOD)
    before = path.read_bytes()
    with pytest.raises(OutputError, match="the disk is full"):
        write_hypotheses(path, tetX, random_rotations(60), method=METHOD)
    assert path.read_bytes() == before
    assert left_beside(path) == []


def test_the_grid_of_these_tests_has_as_many_cells_as_they_say():
    assert grid_size(LEVEL) == CELLS
