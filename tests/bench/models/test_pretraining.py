"""Which hypothesis network a classifier begins with."""

import json
from dataclasses import replace

import pytest
from changed_checkpoints import copy_of
from tiny_training import CLASSIFIER, CPU

from symsol_annot.bench.models.training.checkpoints import read_record
from symsol_annot.bench.models.training.loop import train
from symsol_annot.bench.models.training.pretraining import best_network, trained_networks
from symsol_annot.bench.models.training.record import record_to_metadata
from symsol_annot.errors import WeightsError


def test_the_best_network_has_the_lowest_error_and_on_a_tie_the_lower_other(trained, tmp_path):
    like = read_record(trained["hypotheses"] / "weights.safetensors")
    errors = {"a": (0.1004, 0.30), "b": (0.1001, 0.20), "c": (0.20, 0.10), "unfinished": (0.0, 0.0)}
    for name, (recall, precision) in errors.items():
        (tmp_path / name).mkdir()
        known = json.loads(json.dumps(list(like.rows)))
        known[-1] |= {"recall_mean_error_rad": recall, "precision_mean_error_rad": precision}
        record = replace(like, rows=tuple(known[: 3 if name == "unfinished" else 4]))
        copy_of(
            trained["hypotheses"] / "weights.safetensors",
            tmp_path / name / "weights.safetensors",
            metadata=record_to_metadata(record),
        )
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "weights.safetensors").write_bytes(b"not ours")
    candidates = trained_networks(tmp_path, like)
    assert [path.parent.name for path in candidates] == ["a", "b", "c"]
    assert best_network(candidates, like, "best-recall").parent.name == "b"
    assert best_network(candidates, like, "best-precision").parent.name == "c"


def test_no_network_or_one_that_does_not_fit_is_refused(trained, images, tmp_path):
    recipe = replace(CLASSIFIER, start="best-recall")
    with pytest.raises(WeightsError, match=r"there is none; train one .*small-wta.*--pretrained"):
        train(recipe, images, tmp_path / "alone" / "run", CPU)
    with pytest.raises(WeightsError, match="expected a hypothesis network"):
        train(recipe, images, tmp_path / "run", replace(CPU, pretrained=(trained["classifier"],)))
    record = replace(read_record(trained["hypotheses"] / "weights.safetensors"), image_size=(224, 224))
    with pytest.raises(WeightsError, match=r"was trained on \(16, 16\), the set has \(224, 224\)"):
        best_network([trained["hypotheses"]], record, "best-recall")
    like = read_record(trained["hypotheses"] / "weights.safetensors")
    other = replace(like, recipe=replace(recipe, backbone="resnet18"))
    with pytest.raises(WeightsError, match="has the backbone narrow-resnet18, the recipe resnet18"):
        best_network([trained["hypotheses"]], other, "best-recall")
    assert [path.parent.name for path in trained_networks(trained["hypotheses"].parent, like)] == ["hypotheses"]
    assert trained_networks(trained["hypotheses"].parent, other) == []
    assert not (tmp_path / "run").exists()
