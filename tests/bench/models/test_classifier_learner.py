"""How a classifier learns beyond the thesis: members, weighted negatives, its first bias, and a shift of its logits."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from tiny_training import CLASSIFIER, CPU

from symsol_annot.bench.models.batches import Batch
from symsol_annot.bench.models.inference import predict
from symsol_annot.bench.models.methods.classifier.method import METHOD, ClassifierLearner, ValidationLogits
from symsol_annot.bench.models.methods.classifier.negatives import near_negatives, random_rotations
from symsol_annot.bench.models.networks.answers import RotationScorer
from symsol_annot.bench.models.training import loop
from symsol_annot.bench.models.training.checkpoints import open_checkpoint
from symsol_annot.bench.models.training.loop import train
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.rotations.groups import cyclic_group, tetrahedral_group
from symsol_annot.rotations.so3 import uniform_rotations
from symsol_annot.sets.dataset import load

torch.set_num_threads(1)
GROUP = tetrahedral_group()


def batch_of(images=3):
    rng = np.random.default_rng(0)
    pictures = torch.from_numpy(rng.integers(0, 256, (images, 16, 16, 3), dtype=np.uint8))
    is_member = torch.zeros((images, 12), dtype=torch.bool)
    is_member[:, [0, 4]] = True
    return Batch(pictures, torch.from_numpy(uniform_rotations(images, rng)).float(), ~is_member, is_member)


def learner_of(recipe):
    model = METHOD.new_model(recipe, None, torch.Generator().manual_seed(0))
    return ClassifierLearner(recipe, model.eval(), GROUP)


@torch.no_grad()
def test_of_several_members_the_loss_is_the_mean_and_wrong_ones_weigh_what_the_recipe_says():
    recipe = replace(CLASSIFIER, members=5, negatives=8, hard_negatives=4, hard_weight=1.0)
    batch, learner = batch_of(), learner_of(recipe)
    losses = learner.losses(batch, 0.0, torch.Generator().manual_seed(3))
    rng = torch.Generator().manual_seed(3)
    right = learner._right(batch, rng)
    wrong, weights = learner._wrong(batch, rng)
    assert right.shape == (3, 5, 3, 3)
    members = batch.R_gt[:, None] @ torch.from_numpy(GROUP[[0, 4]]).float()
    nearest = torch.cdist(right.flatten(2), members.flatten(2)).min(-1).values
    assert nearest.max() < 1e-4
    assert torch.equal(weights[0], torch.tensor([1.0] * 4 + [0.25] * 4))
    embeddings = learner.model.first_stage(batch.images)
    p_right, p_wrong = (learner.model.logits(embeddings, R).double().sigmoid() for R in (right, wrong))
    expected = -p_right.log().mean(1) - (weights * (1 - p_wrong).log()).sum(1)
    assert torch.allclose(losses.double(), expected, atol=1e-4)


@pytest.mark.parametrize("group", [GROUP, cyclic_group(720)], ids=["tetrahedral", "a circle"])
def test_near_negatives_stand_for_uniform_ones(group):
    """What they say of the share of rotations within 20 degrees of a candidate is what uniform ones say."""
    rng = torch.Generator().manual_seed(0)
    R_gt = torch.eye(3)[None].expand(40, 3, 3)
    elements = torch.from_numpy(group).float()
    drawn, weights = near_negatives(R_gt, elements, random_rotations((40, 400), rng), 400, rng)
    assert drawn.shape == (40, 800, 3, 3)
    assert float(weights.mean()) == pytest.approx(1.0, abs=0.03)

    def is_near(R):
        cosines = (R.flatten(1) @ elements[:: max(1, len(elements) // 240)].flatten(1).T).amax(1)
        return (cosines > 1 + 2 * math.cos(math.radians(20))).float()

    uniform = is_near(random_rotations((40_000,), rng)).mean()
    weighted = (weights.flatten() * is_near(drawn.flatten(0, 1))).mean()
    assert float(weighted) == pytest.approx(float(uniform), rel=0.08)
    unweighted = is_near(drawn.flatten(0, 1)).mean()
    assert unweighted > 1.5 * uniform


@torch.no_grad()
def test_the_first_logits_are_those_of_k_wrong_rotations_to_one_right_one():
    plain, biased = (
        METHOD.new_model(replace(CLASSIFIER, bias_from_negatives=b), None, torch.Generator()) for b in (0, 1)
    )
    assert float(biased.second_stage.logit.bias) == pytest.approx(-math.log(CLASSIFIER.negatives))
    assert abs(float(plain.second_stage.logit.bias)) < 0.1


@torch.no_grad()
def test_shares_of_rotations_give_the_logits_of_asking_in_one():
    learner, batch = learner_of(CLASSIFIER), batch_of()
    embeddings = learner.model.first_stage(batch.images)
    R = torch.from_numpy(uniform_rotations(1500, np.random.default_rng(1))).float()
    whole = learner.model.logits(embeddings, R)
    for embedding, expected in zip(embeddings, whole, strict=True):
        assert torch.allclose(
            RotationScorer(learner.model).logits(embedding, learner.model.shares(R)), expected, atol=1e-5
        )


def test_far_rotations_count_for_those_that_were_not_asked():
    one = ValidationLogits(torch.tensor([3.0, 0.0]), torch.tensor([2.0, -1.0]), torch.tensor([5.0, 0.0, -9.0]), 40.0)
    assert one.counts(0.0) == (1, 1 + 40, 2)
    assert one.counts(2.0) == (2, 1 + 80, 2)
    assert one.counts(-9.0) == (0, 0, 2)


def test_validation_counts_are_those_of_the_whole_grid(data):
    with load(data / "tetX", "train") as images:
        labels = images.labels()
        pictures = torch.from_numpy(np.stack([sample.image for sample in images[:2]]))
    learner = learner_of(CLASSIFIER)
    (first, _) = learner.validation_logits(pictures, labels)
    assert len(first.members) == labels.set_sizes[0]
    total = len(first.near) + round(len(first.far) * first.far_weight)
    assert total == 294_912


def test_a_fitted_shift_is_kept_and_used(data, tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "plot_curve", lambda *_: None)
    recipe = replace(CLASSIFIER, epochs=1, learning_rates=(1e-3,), milestones=(), frozen_epochs=0, fitted_shift=True)
    with load(data / "tetX", "train") as images:
        record = train(recipe, images, tmp_path / "run", CPU, name="mine")
    assert set(record.calibration) == {"logit_shift", "f_measure"}
    checkpoint = open_checkpoint(tmp_path / "run")
    found = {}
    for shift in (-30.0, 30.0):
        shifted = replace(checkpoint, record=replace(checkpoint.record, calibration={"logit_shift": shift}))
        with load(data / "tetX") as test:
            predict(shifted, test, tmp_path / f"{shift}.h5", torch.device("cpu"), level=1)
        found[shift] = score_file(tmp_path / f"{shift}.h5", data).tracks["classifier"].figures["all"]["recall"].value
    assert found == {-30.0: 0.0, 30.0: 1.0}
