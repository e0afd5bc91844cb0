"""The set that a predictions file is about, in a folder of sets."""

import pytest

import symsol_annot
from symsol_annot.bench.predictions.truth import find_set
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.bench.submission import write_hypotheses
from symsol_annot.errors import DataError, PredictionsError


def test_an_object_that_data_does_not_hold_is_a_fault_of_data(scores, data):
    with pytest.raises(DataError, match="holds no set of the object 'cube'"):
        scores(attributes={"object": "cube"})


def test_an_object_of_another_set_is_named_where_data_is_a_set(scores, tmp_path, data):
    with pytest.raises(DataError):
        scores(attributes={"object": "cylO"})
    with pytest.raises(PredictionsError, match="'object': expected 'tetX', found 'cylO'; --data names"):
        score_file(tmp_path / "preds.h5", data / "tetX")


def test_predictions_about_the_packages_own_set_find_it_where_no_folder_holds_it(tmp_path, data):
    sample = symsol_annot.load_sample("tetX")
    write_hypotheses(tmp_path / "preds.h5", sample, sample.labels().rotation[:, None], method="truth")
    found = [score_file(tmp_path / "preds.h5", folder) for folder in (tmp_path / "nowhere", data, sample.folder)]
    assert len({str(scored.tracks["hypotheses"].figures) for scored in found}) == 1
    assert find_set(data, "tetX", "train", sample.fingerprint) == data / "tetX"  # it is the test split's
