"""How a classifier learns sets that fill a volume: negatives inside it are left out, or all weigh little together."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from tiny_training import CLASSIFIER
from volume_truths import CANDIDATES, COSINE, SHARE, cap, made_truth, to_cap

from symsol_annot.annotation.volume import CELLS, Volume
from symsol_annot.bench.models.batches import Batch, rolled
from symsol_annot.bench.models.methods.classifier.method import METHOD, ClassifierLearner
from symsol_annot.bench.models.methods.classifier.negatives import random_rotations
from symsol_annot.bench.models.volumes import ImageVolumes
from symsol_annot.rotations.so3 import uniform_rotations

torch.set_num_threads(1)
CAP = cap()
OUTSIDE = replace(CLASSIFIER, negatives=40, negatives_outside=True)


def batch_of(images=6):
    rng = np.random.default_rng(0)
    labels = made_truth(images, rng, CAP).labels
    pictures = torch.from_numpy(rng.integers(0, 256, (images, 16, 16, 3), dtype=np.uint8))
    return Batch(pictures, torch.from_numpy(labels.rotation).float(), volumes=ImageVolumes.of(labels)), labels


def learner_of(recipe):
    model = METHOD.new_model(recipe, None, torch.Generator().manual_seed(0))
    return ClassifierLearner(recipe, model.eval(), CANDIDATES)


@pytest.mark.parametrize("is_of_directions", [True, False])
def test_rotations_are_inside_the_volume_of_their_own_image(is_of_directions):
    batch, labels = batch_of()
    volume = CAP if is_of_directions else Volume(CAP.mask & (np.arange(CELLS) % 7 > 0))
    assert volume.is_of_directions == is_of_directions
    R = uniform_rotations(6 * 500, np.random.default_rng(1)).reshape(6, 500, 3, 3)
    found = ImageVolumes(batch.volumes.index, (volume,)).contain(torch.from_numpy(R).float()).numpy()
    for i in range(6):
        expected = volume.contains(R[i]) & (labels.volume[i] >= 0)
        edge = np.abs(-R[i, :, 2, 2] - COSINE) < 1e-5 if is_of_directions else np.ones(500, dtype=bool)
        np.testing.assert_array_equal(found[i][~edge], expected[~edge])
        assert (found[i] != expected).mean() < 0.01
    assert found.any()


def test_volumes_of_images_are_taken_like_tensors():
    batch, labels = batch_of()
    np.testing.assert_array_equal(batch.volumes.index.numpy(), labels.volume)
    some = batch.rows(torch.tensor([4, 0])).to(torch.device("cpu"))
    np.testing.assert_array_equal(some.volumes.index.numpy(), labels.volume[[4, 0]])
    none = ImageVolumes.of(replace(labels, volume=None, volumes=()))
    assert not none.contain(random_rotations((6, 50), torch.Generator().manual_seed(0))).any()


def test_rotations_are_drawn_evenly_in_the_volume_of_their_own_image():
    small = Volume.of_directions(lambda v: v[:, 0] >= 0.9)
    volumes = ImageVolumes(torch.tensor([0, 1, 0]), (CAP, small))
    torch.testing.assert_close(volumes.measures(), torch.tensor([SHARE, small.measure, SHARE], dtype=torch.float32))
    torch.testing.assert_close(ImageVolumes(torch.tensor([-1]), (CAP,)).measures(), torch.zeros(1))
    drawn = volumes.draw(4000, torch.Generator().manual_seed(0))
    assert drawn.shape == (3, 4000, 3, 3)
    assert drawn.dtype == torch.float32
    assert torch.equal(drawn, volumes.draw(4000, torch.Generator().manual_seed(0)))
    R = drawn.double().numpy()
    for i, volume in enumerate((CAP, small, CAP)):
        assert (volume.distance(R[i]) < 1e-5).all()
    heights = -R[0, :, 2, 2]  # even from the cap's edge to its pole, as areas on a sphere are
    assert heights.mean() == pytest.approx((1 + COSINE) / 2, abs=3 * (1 - COSINE) / np.sqrt(12 * 4000))
    assert not torch.equal(drawn[0], drawn[2])


def test_a_turned_image_has_the_same_volume():
    batch, _ = batch_of(8)
    R = random_rotations((8, 300), torch.Generator().manual_seed(0))
    quarter = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = rolled(batch)
    agree = turned.volumes.contain(quarter @ R) == batch.volumes.contain(R)
    assert float(agree.float().mean()) > 0.99


@torch.no_grad()
def test_negatives_inside_the_volume_weigh_nothing_and_the_loss_is_its_equation():
    batch, labels = batch_of()
    learner = learner_of(OUTSIDE)
    losses = learner.losses(batch, 0.0, torch.Generator().manual_seed(3))
    wrong = random_rotations((6, 40), torch.Generator().manual_seed(3))
    is_inside = np.array(
        [(to_cap(R.double().numpy()) == 0) & (v >= 0) for R, v in zip(wrong, labels.volume, strict=True)]
    )
    assert 0 < is_inside[labels.volume >= 0].mean() < 0.6
    embeddings = learner.model.first_stage(batch.images)
    right, at_wrong = (learner.model.logits(embeddings, R).double().sigmoid() for R in (batch.R_gt[:, None], wrong))
    expected = -right.log().sum(1) - torch.where(torch.from_numpy(is_inside), 0.0, (1 - at_wrong).log()).sum(1)
    assert torch.allclose(losses.double(), expected, atol=1e-4)


@torch.no_grad()
def test_all_negatives_weigh_together_what_the_recipe_says():
    batch, _ = batch_of()
    for recipe in (replace(OUTSIDE, negatives_weight=0.2), replace(OUTSIDE, negatives_weight=0.2, near_negatives=10)):
        learner = learner_of(replace(recipe, negatives_outside=False))
        _, weights = learner._wrong(batch._replace(volumes=None), torch.Generator().manual_seed(0))
        assert float(weights.sum(1).mean()) == pytest.approx(0.2, rel=0.1 if recipe.near_negatives else 1e-5)
        _, left = learner._wrong(batch, torch.Generator().manual_seed(0))
        assert (left <= weights).all()
        assert float(left.sum()) < float(weights.sum())


@torch.no_grad()
def test_a_set_without_a_volume_has_the_loss_that_it_had():
    batch, labels = batch_of()
    learner = learner_of(OUTSIDE)
    found = learner.losses(batch, 0.0, torch.Generator().manual_seed(5))
    plain = learner.losses(batch._replace(volumes=None), 0.0, torch.Generator().manual_seed(5))
    without = torch.from_numpy(labels.volume < 0)
    assert torch.allclose(found[without], plain[without], atol=1e-5)
    assert (found[~without] < plain[~without] - 1e-3).all()


def learnt(weight_inside, weight_outside, share):
    """The logits inside and outside of a set at which the expected loss of many draws is least, by gradient descent.

    Right rotations are uniform in the set. Of the negatives, `share` are inside.
    """
    f = torch.zeros(2, requires_grad=True, dtype=torch.float64)
    softplus = torch.nn.functional.softplus
    optimizer = torch.optim.LBFGS([f], max_iter=200, line_search_fn="strong_wolfe")

    def loss():
        optimizer.zero_grad()
        value = softplus(-f[0]) + share * weight_inside * softplus(f[0]) + (1 - share) * weight_outside * softplus(f[1])
        value.backward()
        return value

    optimizer.step(loss)
    return f.detach().sigmoid().tolist()


@pytest.mark.parametrize("share", [0.05, SHARE, 0.9])
def test_what_the_losses_learn_of_a_volume(share):
    thesis, _ = learnt(4096.0, 4096.0, share)
    assert thesis < 0.01  # K h rotations of the set are called wrong: nothing of it is claimed
    left_out, outside = learnt(0.0, 4096.0, share)
    assert left_out > 0.99
    assert outside < 0.01
    weighed, outside = learnt(0.2, 0.2, share)
    assert weighed == pytest.approx((1 / share) / (1 / share + 0.2), abs=1e-3)
    assert weighed > 0.8
    assert outside < 0.05


def test_a_weight_that_is_no_weight_is_a_fault_of_the_recipe():
    assert any("negatives_weight" in fault for fault in replace(CLASSIFIER, negatives_weight=-1.0).faults())
    assert not any("negatives_weight" in fault for fault in replace(CLASSIFIER, negatives_weight=0.2).faults())


@torch.no_grad()
def test_validation_counts_a_volume_as_the_score_does():
    truth = made_truth(3, np.random.default_rng(0), CAP)
    pictures = torch.zeros((3, 16, 16, 3), dtype=torch.uint8)
    for one, size in zip(learner_of(OUTSIDE).validation_logits(pictures, truth.labels), truth.set_sizes, strict=True):
        assert one.counts(1e6)[2] == size
        assert one.counts(1e6)[0] == size
        total = len(one.near) + round(len(one.far) * one.far_weight) + one.inside_count
        assert total == 294_912
        assert one.counts(-1e6) == (0, 0, size)


def test_training_claims_a_volume_that_it_is_told_of_or_that_negatives_weigh_little_against():
    """A tiny run on one blank picture that any rotation in the cap draws, with new ones at each step."""
    images, K = 4, 32
    volumes = ImageVolumes(torch.zeros(images, dtype=torch.long), (CAP,))
    blank = torch.zeros((images, 16, 16, 3), dtype=torch.uint8)
    inside = torch.from_numpy(CAP.sample(400, np.random.default_rng(0))).float()[None]
    every = random_rotations((400,), torch.Generator().manual_seed(1))
    outside = every[torch.from_numpy(to_cap(every.double().numpy()) > 0.3)][None]
    plain = replace(CLASSIFIER, negatives=K)
    recipes = {
        "the thesis's": plain,
        "told": replace(plain, negatives_outside=True),
        "weighed": replace(plain, negatives_weight=0.2),
    }
    claims = {}
    for name, recipe in recipes.items():
        learner = learner_of(recipe)
        optimizer = torch.optim.Adam(learner.model.second_stage.parameters(), lr=5e-3)
        rng, drawn = torch.Generator().manual_seed(0), np.random.default_rng(0)
        for _ in range(90):
            R_gt = torch.from_numpy(CAP.sample(images, drawn)).float()
            optimizer.zero_grad()
            learner.losses(Batch(blank, R_gt, volumes=volumes if name == "told" else None), 9.0, rng).mean().backward()
            optimizer.step()
        with torch.no_grad():
            embedding = learner.model.first_stage(blank[:1])
            claims[name] = [
                float((learner.model.logits(embedding, R).sigmoid() > 0.8).float().mean()) for R in (inside, outside)
            ]
    assert claims["the thesis's"] == [0.0, 0.0]
    for name in ("told", "weighed"):
        of_inside, of_outside = claims[name]
        assert of_inside > 0.7, claims
        assert of_outside < 0.1, claims
