"""Predictions files: what is valid is scored, and all of a file's faults are named at once.

The files are written with h5py alone. Processes that read them are forked (forked_readers.py), which is faster;
test_sandboxed_file.py is about the processes that the product starts.
"""

import hashlib
import os
import re
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from changed_predictions import figures, replaced, with_rows
from valid_predictions import HYPOTHESES, IMAGES, STORAGE

from symsol_annot.bench.predictions.predictions_reader import open_predictions
from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.bench.scoring.reports.report import to_document
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import PredictionsError


def replaced_by_itself(path):
    copy = path.with_suffix(".copy")
    shutil.copyfile(path, copy)
    copy.replace(path)


@pytest.mark.parametrize("change", [lambda path: os.utime(path, (0, 0)), replaced_by_itself, Path.unlink])
def test_a_file_that_is_changed_or_replaced_before_it_was_read_to_its_end_is_refused(scores, tmp_path, data, change):
    scores()
    path = tmp_path / "preds.h5"

    def check_and_change():
        with open_predictions(path, data) as predictions:
            predictions.check()
            change(path)

    with pytest.raises(PredictionsError, match="the file: was changed while it was read"):
        check_and_change()


def test_scores_have_the_digest_of_the_file_that_was_read_whatever_becomes_of_it(scores, tmp_path):
    scored = scores(tracks=["hypotheses"])
    path = tmp_path / "preds.h5"
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    path.unlink()
    document = to_document([scored])["objects"]["tetX"]
    assert document["predictions"] == {"file": "preds.h5", "sha256": sha256}


def test_a_file_that_is_far_larger_than_its_data_sets_is_refused_without_reading_it_all(scores, tmp_path, data):
    scores()
    path = tmp_path / "preds.h5"
    os.truncate(path, 2**40)  # whose digest would take a quarter of an hour
    start = time.monotonic()
    with pytest.raises(PredictionsError, match=r"has 1,099,511,627,776 bytes, of which its data sets need [\d,]+; "):
        score_file(path, data)
    assert time.monotonic() - start < 60


@pytest.mark.parametrize("libver", [("earliest", "v108"), ("latest", "latest")], ids=["old", "new"])
@pytest.mark.parametrize("storage", STORAGE)
def test_a_score_does_not_depend_on_how_a_file_is_stored(scores, storage, libver):
    assert figures(scores(storage=STORAGE[storage], libver=libver)) == pytest.approx(figures(scores()), nan_ok=True)


@pytest.mark.parametrize("types", [{"f": ">f8", "i": ">i8"}, {"f": "<f4", "i": "<i4"}, {"f": ">f4", "i": ">i4"}])
def test_a_score_does_not_depend_on_the_order_of_bytes_and_hardly_on_their_number(scores, valid, types):
    columns = {name: column.astype(types[column.dtype.kind]) for name, column in valid[0].items()}
    expected = figures(scores(valid[0], attributes={"floor": 0.05}))
    assert figures(scores(columns, attributes={"floor": 0.05})) == pytest.approx(expected, nan_ok=True, abs=1e-5)


def test_a_score_does_not_depend_on_the_order_of_the_rows(scores, valid):
    order = np.array([3, 1, 0, 5, 4, 2])
    columns = {name: column[order] for name, column in valid[0].items() if len(column) == IMAGES}
    for track in "grid", "density":
        names = [name for name in valid[0] if name.startswith(f"{track}_") and "offsets" not in name]
        for name in names:
            rows = np.split(valid[0][name], valid[0][f"{track}_offsets"][1:-1])
            columns[f"{track}_offsets"], columns[name] = with_rows(*(rows[r] for r in order))
    assert figures(scores(columns)) == pytest.approx(figures(scores()), nan_ok=True)


def test_chunks_may_be_larger_than_the_data_and_a_file_may_begin_late(scores, tmp_path, data):
    expected = figures(scores())

    def store_again(file):
        column = file["image_index"][...]
        del file["image_index"]
        file.create_dataset("image_index", data=column, chunks=(4096,), maxshape=(None,), compression="gzip")

    assert figures(scores(edit=store_again)) == pytest.approx(expected, nan_ok=True)
    late = tmp_path / "late.h5"
    late.write_bytes(bytes(2**20) + (tmp_path / "preds.h5").read_bytes())
    assert figures(score_file(late, data)) == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize("track", TRACKS)
def test_a_file_may_hold_one_track(scores, track):
    assert list(scores(tracks=[track]).tracks) == [track]


def test_signalling_nans_are_nans(faults, valid):
    for name in ("hypotheses", "query_probability", "grid_probabilities", "density_log_probabilities"):
        column = valid[0][name].astype(np.float32)
        column.reshape(-1).view(np.uint32)[0] = 0x7FA00000
        assert f"'{name}'" in faults({name: column})


@pytest.mark.parametrize("content", [b"", b"\0", b"hypotheses,1,2,3\n" * 999, b"\x89HDF\r\n\x1a\n", b"GIF89a" * 99])
def test_what_is_no_hdf5_is_refused_with_hdf5s_words(refused, content):
    assert refused(content).startswith("cannot be read as HDF5: ")


@pytest.mark.parametrize("libver", [("earliest", "v108"), ("latest", "latest")], ids=["old", "new"])
def test_a_truncated_file_is_refused_wherever_it_ends(refused, scores, tmp_path, libver):
    scores(libver=libver)
    whole = (tmp_path / "preds.h5").read_bytes()
    for length in (*range(1, len(whole), len(whole) // 40), len(whole) - 1):
        assert re.search("cannot be read as HDF5|damaged", refused(whole[:length])), length


def test_damage_under_a_checksum_is_named_beside_the_other_faults(faults, tmp_path, data, valid):
    stored = {"chunks": (IMAGES, HYPOTHESES, 3, 3), "fletcher32": True}
    faults(
        {"query_probability": valid[0]["query_probability"] + 2},
        edit=replaced("hypotheses", data=valid[0]["hypotheses"], **stored),
    )
    path = tmp_path / "preds.h5"
    content = path.read_bytes()
    column = valid[0]["hypotheses"].tobytes()
    at = content.rindex(column)
    path.write_bytes(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :])
    with pytest.raises(PredictionsError) as caught:
        score_file(path, data)
    checksum, range_ = caught.value.faults
    assert checksum.startswith("the file: 'hypotheses': is damaged: ")
    assert range_.startswith("classifier: 'query_probability' is not in [0, 1]")


def test_a_file_of_another_kind_of_hdf5_says_what_it_lacks(refused, data):
    shard = next((data / "tetX").glob("*.h5"))
    assert refused(shard.read_bytes()).startswith("the file: attribute 'format': expected 'symsol-annot predictions'")
