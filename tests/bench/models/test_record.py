"""What a checkpoint says of its training: read back within bounds, and its best epoch."""

import pytest
from changed_checkpoints import changed_record, copy_of

from symsol_annot.bench.models.training.checkpoints import open_checkpoint, read_record
from symsol_annot.bench.models.training.record import best_epoch
from symsol_annot.errors import WeightsError

WRONG = {
    "a name of two lines": ({"name": "a\nb"}, "name: expected 1 to 200 printable"),
    "a name that is a number": ({"name": 3}, "name: expected 1 to 200 printable"),
    "an object that is a path": ({"object": "../../etc"}, "object: expected 1 to 64 letters"),
    "an object that is a list": ({"object": ["tetX"]}, "object: expected 1 to 64 letters"),
    "a size that is text": ({"image_size": "16"}, "image_size: expected two whole numbers"),
    "a size of one side": ({"image_size": [16]}, "image_size: expected two whole numbers"),
    "a size of true": ({"image_size": [True, 16]}, "image_size: expected two whole numbers"),
    "a size of fractions": ({"image_size": [16.0, 16]}, "image_size: expected two whole numbers"),
    "a huge size": ({"image_size": [10**9, 16]}, "image_size: expected two whole numbers"),
    "no epochs": ({"epochs": 0}, "epochs: expected 1 to 10000"),
    "epochs of true": ({"epochs": True}, "epochs: expected 1 to 10000"),
    "10^30 epochs": ({"epochs": 10**30}, "epochs: expected 1 to 10000"),
    "fewer epochs than rows": ({"epochs": 3}, "rows: expected a list of up to 3"),
    "a negative seed": ({"seed": -1}, "seed: expected 0 to"),
    "a seed of text": ({"seed": "0"}, "seed: expected 0 to"),
    "a fingerprint without end": ({"train_fingerprint": "x" * 2000}, "train_fingerprint: expected text of up to"),
    "a first stage that is none": ({"first_stage": None}, "first_stage: expected text"),
    "rows that are a number": ({"rows": 4}, "rows: expected a list"),
    "a row that is a list": ({"rows": [[1]]}, "not in 1"),
    "a figure that is a list": ({"row_loss": [1.0]}, "not in 2"),
    "a figure that is true": ({"row_recall_mean_error_rad": True}, "not in 2"),
    "a figure that is text": ({"row_seconds": "1.0"}, "not in 2"),
    "a loss that is not a number": ({"row_loss": float("nan")}, "not in 2"),
    "an infinite figure": ({"row_recall_mean_error_rad": float("inf")}, "not in 2"),
    "a figure of 400 digits": ({"row_seconds": 10**400}, "not in 2"),
    "another epoch's row": ({"row_epoch": 3}, "not in 2"),
    "a row without its loss": ({"rows": [{"epoch": 1}]}, "not in 1"),
    "versions that are a list": ({"software": []}, "software: expected texts"),
    "extensions that are a number": ({"extensions": 1}, "extensions: expected pairs"),
    "an extension that is no pair": ({"extensions": [[1, 2, 3]]}, "extensions: expected pairs"),
    "an extension of true": ({"extensions": [[True, 2]]}, "extensions: expected pairs"),
    "an extension from as many epochs": ({"extensions": [[1, 4]]}, "extensions: expected pairs"),
    "an extension after more than there were": ({"extensions": [[3, 2]]}, "extensions: expected pairs"),
    "an extension after nothing": ({"extensions": [[0, 2]]}, "extensions: expected pairs"),
    "extensions that go back": ({"extensions": [[2, 2], [1, 3]]}, "extensions: expected pairs"),
    "a version that is a number": ({"software": {"torch": 2}}, "software: expected texts"),
}


@pytest.mark.parametrize(("changes", "said"), WRONG.values(), ids=WRONG)
def test_a_record_of_other_types_or_beyond_bounds_is_refused(changes, said, trained, tmp_path):
    path = changed_record(trained["hypotheses"] / "weights.safetensors", tmp_path / "a.safetensors", **changes)
    with pytest.raises(WeightsError, match="what it says of its training is damaged: ") as caught:
        read_record(path)
    assert said in str(caught.value)
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize(
    ("metadata", "said"),
    [
        ({"record": "[" * 100_000}, "is damaged"),
        ({"record": '"text"'}, "expected a record's parts by their names"),
        ({"record": "{}"}, "'image_size' is missing"),
        ({"record": '{"image_size": ' + "9" * 10_000 + "}"}, "is damaged"),
        ({"format_version": "9" * 5000}, "format_version 1, found '9999"),
        ({"format_version": "\u0661"}, "format_version 1, found"),
        ({"recipe": "a = " + "[" * 9999}, "is no TOML: it is nested too deep"),
        ({"recipe": "x" * 10**6}, "it has 1,000,000 characters, more than"),
    ],
)
def test_metadata_that_were_made_to_do_harm_are_one_short_error(metadata, said, trained, tmp_path):
    path = copy_of(trained["hypotheses"] / "weights.safetensors", tmp_path / "a.safetensors", metadata=metadata)
    for opened in (read_record, open_checkpoint):
        with pytest.raises(WeightsError) as caught:
            opened(path)
        assert said in str(caught.value)
        assert len(str(caught.value)) < 1000


def test_an_epoch_whose_figure_is_undefined_is_not_the_best(trained, tmp_path):
    whole = trained["hypotheses"] / "weights.safetensors"
    figure = "recall_mean_error_rad"
    best = best_epoch(read_record(whole))
    rows = [dict(row) for row in read_record(whole).rows]
    for undefined in range(4):
        changed = [row | ({figure: float("nan")} if epoch == undefined else {}) for epoch, row in enumerate(rows)]
        record = read_record(changed_record(whole, tmp_path / "a.safetensors", rows=changed))
        known = [epoch for epoch in range(4) if epoch != undefined]
        assert best_epoch(record) == min(reversed(known), key=lambda epoch: rows[epoch][figure]) + 1
    assert best in range(1, 5)
