"""Negatives: random rotations are all over, and hard ones are candidates that the image rules out."""

import numpy as np
import pytest
import torch
from made_sets import make_set

from symsol_annot import load_sample
from symsol_annot.bench.models.methods.classifier.method import METHOD
from symsol_annot.bench.models.methods.classifier.negatives import hard_negatives, random_rotations
from symsol_annot.bench.models.methods.classifier.recipe import ClassifierRecipe
from symsol_annot.bench.models.training import batch_sources
from symsol_annot.bench.models.training.batch_sources import open_batches
from symsol_annot.bench.models.training.checkpoints import new_model
from symsol_annot.bench.models.training.loop import Options, train
from symsol_annot.bench.predictions.truth import HARD_NEGATIVE_RAD
from symsol_annot.errors import NotAnnotatedError
from symsol_annot.rotations.so3 import angle_between, rotation_deviation
from symsol_annot.sets.dataset import load

RECIPE = ClassifierRecipe(
    title="hard",
    epochs=1,
    batch_size=4,
    learning_rates=(1e-3,),
    milestones=(),
    validation_images=0,
    negatives=8,
    hard_negatives=3,
    frozen_epochs=0,
    start="random",
)


def rng():
    return torch.Generator().manual_seed(0)


def test_random_rotations_are_rotations_all_over():
    R = random_rotations((4000,), rng()).double().numpy()
    assert rotation_deviation(R).max() < 1e-5
    assert np.abs(R.mean(axis=0)).max() < 0.05
    assert np.abs((R[:, :, :, None] * R[:, :, None, :]).mean(axis=(0, 1)) - np.eye(3) / 3).max() < 0.02


@pytest.mark.parametrize("name", ["cylO", "tetX"])
def test_rejected_candidates_are_no_members_and_not_within_5_degrees_of_one(name):
    with load_sample(name) as images:
        labels = images.labels()
    is_rejected = labels.rejected_beyond(HARD_NEGATIVE_RAD)
    assert is_rejected.any()
    for i, R in enumerate(labels.rotation[:16]):
        members = labels.symmetry_set(i)
        for g, element in enumerate(labels.symmetry_group):
            nearest = np.degrees(angle_between(R @ element, members)).min()
            assert is_rejected[i, g] == (nearest > 5.001)


def test_hard_negatives_are_all_the_rejected_and_random_where_none_are():
    with load_sample("tetX") as images:
        labels = images.labels()
    is_rejected = labels.rejected_beyond(HARD_NEGATIVE_RAD)[:6]
    is_rejected[2] = False
    R_gt, group = (torch.tensor(R, dtype=torch.float32) for R in (labels.rotation[:6], labels.symmetry_group))
    drawn = hard_negatives(R_gt, torch.from_numpy(is_rejected), group, 200, rng())
    assert drawn.shape == (6, 200, 3, 3)
    assert rotation_deviation(drawn.double().numpy().reshape(-1, 3, 3)).max() < 1e-5
    for i, of_image in enumerate(drawn.double().numpy()):
        candidates = labels.rotation[i] @ labels.symmetry_group
        angles = np.stack([angle_between(R, candidates) for R in of_image])
        if i == 2:
            assert (angles.min(axis=1) > 0.01).mean() > 0.9
        else:
            assert angles.min(axis=1).max() < 1e-3
            assert set(angles.argmin(axis=1)) == set(np.flatnonzero(is_rejected[i]))


def test_a_classifier_is_asked_about_the_recipe_s_share_of_them(tmp_path, monkeypatch):
    with load(make_set(tmp_path, "tetX", train=8, test=1, size=16, annotate="all"), "train") as images:
        labels = images.labels()
        model = new_model(RECIPE, None, 0)
        learner = METHOD.learner(RECIPE, model, images.symmetry_group)
        asked, logits = [], model.logits
        monkeypatch.setattr(model, "logits", lambda embeddings, R: asked.append(R) or logits(embeddings, R))
        (batch, _) = open_batches(images, 4, 0, torch.device("cpu"), with_rejected=True).batches(0)
        learner.losses(batch, 0.0, rng())
    (R,) = asked
    assert R.shape == (4, 1 + 8, 3, 3)
    for of_image in R.double().numpy():
        (i,) = (i for i, known in enumerate(labels.rotation) if np.allclose(known, of_image[0], atol=1e-6))
        candidates = labels.rotation[i] @ labels.symmetry_group
        near = [angle_between(one, candidates).min() < 1e-3 for one in of_image]
        assert near == [True] + [False] * 5 + [True] * 3
        of_members = [angle_between(one, labels.symmetry_set(i)).min() for one in of_image[-3:]]
        assert min(of_members) > np.radians(5)


def test_workers_say_the_same_of_an_image_as_memory_does(tmp_path, monkeypatch):
    with load(make_set(tmp_path, "tetX", train=8, test=1, size=16, annotate="all"), "train") as images:
        known = []
        for free in (10**9, 1000):
            monkeypatch.setattr(batch_sources, "free_bytes", lambda _, free=free: free)
            data = open_batches(images, 4, 0, torch.device("cpu"), with_rejected=True)
            of_image = {
                tuple(R.flatten().tolist()): tuple(mask.tolist())
                for batch in data.batches(0)
                for R, mask in zip(batch.R_gt, batch.is_rejected, strict=True)
            }
            known.append((data.where, of_image))
    assert [where for where, _ in known] == ["memory", "worker processes"]
    assert known[0][1] == known[1][1]
    assert len(known[0][1]) == 8


def test_a_split_without_sets_has_no_hard_negatives(tmp_path):
    folder = make_set(tmp_path, "tetX", train=8, test=1, size=16, annotate="test")
    with (
        load(folder, "train") as images,
        pytest.raises(NotAnnotatedError, match=r"hard_negatives are.*--annotate all.*hard_negatives = 0 needs none"),
    ):
        train(RECIPE, images, tmp_path / "run", Options(device="cpu"))
