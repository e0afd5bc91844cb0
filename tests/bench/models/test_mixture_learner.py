"""The losses of mixtures are the equations of their page, image by image, for each structure."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from tiny_training import MIXTURE
from volume_truths import CANDIDATES, cap, made_truth, to_cap

from symsol_annot.bench.models.batches import Batch
from symsol_annot.bench.models.methods.mixture.body import body_for
from symsol_annot.bench.models.methods.mixture.calibration import _of_image
from symsol_annot.bench.models.methods.mixture.claims import Calibration
from symsol_annot.bench.models.methods.mixture.densities import Densities
from symsol_annot.bench.models.methods.mixture.learner import MixtureLearner
from symsol_annot.bench.models.methods.mixture.method import METHOD
from symsol_annot.bench.models.networks.mixtures import PoseMixture
from symsol_annot.bench.models.volumes import ImageVolumes
from symsol_annot.errors import SettingsError
from symsol_annot.rotations.grid import equivolumetric_grid
from symsol_annot.rotations.groups import cyclic_group, dihedral_group, tetrahedral_group
from symsol_annot.rotations.so3 import uniform_rotations

torch.set_num_threads(1)
FREE = replace(MIXTURE, members=12, precision="float32")  # to the digits of its equations


@pytest.fixture(autouse=True)
def _without_gradients():
    with torch.no_grad():
        yield


def batch_of(group, is_member, size=32):
    rng = np.random.default_rng(3)
    images = torch.from_numpy(rng.integers(0, 255, (len(is_member), size, size, 3), dtype=np.uint8))
    return Batch(images, torch.from_numpy(uniform_rotations(len(is_member), rng)).float(), None, is_member)


def learner_of(recipe, group):
    model = METHOD.new_model(recipe, None, torch.Generator().manual_seed(0))
    return MixtureLearner(recipe, model.eval(), group)


def told(learner, batch):
    return learner.model.told(learner.model.first_stage(batch.images), is_directed=learner._body.is_directed)


def test_free_is_the_mean_over_members_and_the_class_of_the_sets_size():
    group = tetrahedral_group()
    is_member = torch.zeros((3, 12), dtype=torch.bool)
    is_member[0, :3] = is_member[1, :9] = is_member[2] = True
    batch, learner = batch_of(group, is_member), learner_of(FREE, group)
    losses = learner.losses(batch, 0.0, torch.Generator())
    said = told(learner, batch)
    sizes = 12 ** (np.arange(8) / 7)
    for i, count in enumerate((3, 9, 12)):
        members = batch.R_gt[i] @ torch.from_numpy(group).float()[is_member[i]]
        at_members = said.pose.row(i).log_density(members)[0].mean()
        right = int(np.abs(np.log(sizes / count)).argmin())
        of_size = -torch.log_softmax(said.set_size[i], 0)[right]
        assert float(losses[i]) == pytest.approx(float(FREE.marking_weight * of_size - at_members), abs=1e-4)


def test_of_a_set_with_volume_rotations_in_it_are_learnt_and_its_measure_is_its_size(monkeypatch):
    """Of two images that fill a volume and one that does not, which learns as if there were none."""
    candidates, rng = CANDIDATES, np.random.default_rng(0)
    labels, volume = made_truth(3, rng, cap()).labels, cap()
    recipe = replace(FREE, members=4, largest_set=200_000)
    learner = learner_of(recipe, candidates)
    batch = batch_of(candidates, torch.from_numpy(labels.symmetry_mask))._replace(
        R_gt=torch.from_numpy(labels.rotation).float(), volumes=ImageVolumes.of(labels)
    )
    asked, log_density = [], PoseMixture.log_density
    monkeypatch.setattr(PoseMixture, "log_density", lambda of, R: (asked.append(R), log_density(of, R))[1])
    losses = learner.losses(batch, 0.0, torch.Generator().manual_seed(0))
    (R,) = asked
    said = told(learner, batch)
    at_members = log_density(said.pose, R).mean(1)
    sizes = 200_000 ** (np.arange(8) / 7)
    for i, fills in enumerate(labels.volume >= 0):
        measure = labels.symmetry_mask[i].sum() + (294_912 * volume.measure if fills else 0)
        of_size = -torch.log_softmax(said.set_size[i], 0)[int(np.abs(np.log(sizes / measure)).argmin())]
        assert float(losses[i]) == pytest.approx(float(recipe.marking_weight * of_size - at_members[i]), abs=1e-4)
        if fills:
            assert (to_cap(R[i].double().numpy()) < 1e-5).all()
        else:
            members = torch.from_numpy(labels.members(i)).float()
            assert all(min(float((r - m).abs().max()) for m in members) < 1e-5 for r in R[i])
    again = learner.losses(batch, 0.0, torch.Generator().manual_seed(0))
    assert torch.equal(losses, again)


def test_calibration_counts_a_volume_as_the_grid_does():
    """At thresholds that claim some, all or nothing, beside counting by loops over the grid of level 4."""
    labels = made_truth(2, np.random.default_rng(1), cap()).labels
    recipe = replace(FREE, largest_set=200_000)
    body = body_for(recipe, CANDIDATES, torch.device("cpu"))
    model = METHOD.new_model(recipe, None, torch.Generator().manual_seed(0))
    told = model.eval().told(model.first_stage(torch.zeros((1, 32, 32, 3), dtype=torch.uint8)), is_directed=False)
    density = Densities(model, "free", body, Calibration()).of_image(told.cpu().row(0), 0)
    grid = equivolumetric_grid(4)
    log_claim = density.log_claim(torch.from_numpy(grid).float()).numpy()
    is_inside = to_cap(grid) == 0
    for log_factor in (-1.0, 0.0, 1.0):
        true, claimed = int((log_claim > log_factor)[is_inside].sum()), int((log_claim > log_factor).sum())
        expected = 2 * true / (claimed + int(is_inside.sum()))
        assert _of_image(density, labels, 1, np.array([log_factor]))[0] == pytest.approx(expected, abs=2e-5)


def test_of_more_candidates_than_it_takes_it_learns_from_members_alone():
    group = tetrahedral_group()
    is_member = torch.zeros((2, 12), dtype=torch.bool)
    is_member[:, 4] = True
    recipe = replace(FREE, members=5, marking_weight=0.0)
    batch, learner = batch_of(group, is_member), learner_of(recipe, group)
    losses = learner.losses(batch, 0.0, torch.Generator().manual_seed(0))
    member = batch.R_gt[:, None] @ torch.from_numpy(group).float()[4]
    assert torch.allclose(losses, -told(learner, batch).pose.log_density(member)[:, 0], atol=1e-4)


def test_group_is_the_mean_density_over_the_groups_turns():
    group = tetrahedral_group()
    recipe = replace(FREE, structure="group")
    batch, learner = batch_of(group, torch.ones((2, 12), dtype=torch.bool)), learner_of(recipe, group)
    at = told(learner, batch).pose.log_density(batch.R_gt[:, None] @ torch.from_numpy(group).float())
    expected = math.log(12) - torch.logsumexp(at, 1)
    assert torch.allclose(learner.losses(batch, 0.0, torch.Generator()), expected, atol=1e-4)


@pytest.mark.parametrize(("group", "is_directed"), [(cyclic_group(360), True), (dihedral_group(360), False)])
def test_circle_is_the_density_of_the_axis_which_a_half_turn_may_turn_round(group, is_directed):
    recipe = replace(FREE, structure="circle")
    batch, learner = batch_of(group, torch.ones((2, len(group)), dtype=torch.bool)), learner_of(recipe, group)
    assert learner._body.is_directed == is_directed
    expected = -told(learner, batch).axis.log_density(batch.R_gt[:, None, :, 2])[:, 0]
    assert torch.allclose(learner.losses(batch, 0.0, torch.Generator()), expected, atol=1e-4)


def test_marked_circle_adds_the_pose_where_the_marking_shows_and_views_where_it_does_not():
    group = dihedral_group(360)
    is_member = torch.zeros((2, 720), dtype=torch.bool)
    is_member[0, 0] = True
    is_member[1] = True  # every candidate hides it: whichever are drawn, they are members
    recipe = replace(FREE, structure="marked-circle", marking_weight=3.0)
    batch, learner = batch_of(group, is_member), learner_of(recipe, group)
    losses = learner.losses(batch, 0.0, torch.Generator().manual_seed(0))
    said = told(learner, batch)
    of_axis = -said.axis.log_density(batch.R_gt[:, None, :, 2])[:, 0]
    of_pose = -said.pose.log_density(batch.R_gt[:, None])[0, 0]
    shown = of_axis[0] + of_pose - 3.0 * torch.nn.functional.logsigmoid(said.is_shown[0])
    assert float(losses[0]) == pytest.approx(float(shown), abs=1e-4)
    chosen = torch.randint(720, (2, 32), generator=torch.Generator().manual_seed(0))[1]
    views = (batch.R_gt[1] @ torch.from_numpy(group).float()[chosen])[:, 2]
    of_views = -torch.nn.functional.logsigmoid(learner.model.hides(views)).mean()
    hidden = of_axis[1] - 3.0 * torch.nn.functional.logsigmoid(-said.is_shown[1]) + 3.0 * of_views
    assert float(losses[1]) == pytest.approx(float(hidden), abs=1e-4)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"structure": "group", "largest_set": 9},
            'largest_set: is for "free", which tells the size of a set',
        ),
        ({"largest_set": 300_000}, "largest_set: expected 0 to 294912, found 300000"),
    ],
)
def test_a_largest_set_that_means_nothing_is_a_fault(changes, said):
    assert [fault for fault in replace(FREE, **changes).faults() if fault.startswith(said)]
    assert not list(replace(FREE, largest_set=108_000).faults())


def test_a_structure_of_circles_is_refused_for_a_body_without_one():
    with pytest.raises(SettingsError, match=r"'circle' is for a body with a circle.*12 isolated rotations; take \"gro"):
        body_for(replace(FREE, structure="circle"), tetrahedral_group(), torch.device("cpu"))
