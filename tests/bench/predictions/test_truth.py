"""The set that a predictions file is about, in a folder of sets."""

import pytest

from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import DataError, PredictionsError


def test_an_object_that_data_does_not_hold_is_a_fault_of_data(scores, data):
    with pytest.raises(DataError, match="holds no set of the object 'cube'"):
        scores(attributes={"object": "cube"})


def test_an_object_of_another_set_is_named_where_data_is_a_set(scores, tmp_path, data):
    with pytest.raises(DataError):
        scores(attributes={"object": "cylO"})
    with pytest.raises(PredictionsError, match="'object': expected 'tetX', found 'cylO'; --data names"):
        score_file(tmp_path / "preds.h5", data / "tetX")
