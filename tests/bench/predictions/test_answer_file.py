"""The file with the answers about one image."""

import pytest
from written_predictions import Interrupted, write

from symsol_annot.errors import PredictionsError


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
