"""What a mixture answers is what its density says: claims, cells and hypotheses, by one network and in one file."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from made_sets import make_set
from tiny_training import CPU, MIXTURE

from symsol_annot.bench.models.inference import predict
from symsol_annot.bench.models.methods.method import BALANCED, COVERING, SUREST
from symsol_annot.bench.models.methods.mixture.body import body_for
from symsol_annot.bench.models.methods.mixture.calibration import climb
from symsol_annot.bench.models.methods.mixture.cells import grid_of
from symsol_annot.bench.models.methods.mixture.claims import Calibration
from symsol_annot.bench.models.methods.mixture.densities import Densities
from symsol_annot.bench.models.methods.mixture.image_density import LEAST_CELL
from symsol_annot.bench.models.methods.mixture.method import METHOD, heads_of
from symsol_annot.bench.models.training import loop
from symsol_annot.bench.models.training.checkpoints import open_checkpoint
from symsol_annot.bench.models.training.loop import train
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import SettingsError
from symsol_annot.rotations.grid import cell_of
from symsol_annot.rotations.groups import dihedral_group, icosahedral_group, tetrahedral_group
from symsol_annot.rotations.nearest import nearest_angles
from symsol_annot.sets.dataset import load

torch.set_num_threads(1)
GROUPS = {"free": tetrahedral_group, "group": tetrahedral_group, "circle": lambda: dihedral_group(360)}
GROUPS["marked-circle"] = GROUPS["circle"]
LEVEL = 2


@pytest.fixture(autouse=True)
def _no_curves(monkeypatch):
    monkeypatch.setattr(loop, "plot_curve", lambda *_: None)


def density(structure, *, narrower=3.0, calibration=None, seed=0):
    """Return the density of an image that nobody has seen, by a network of random weights with narrow components."""
    recipe = replace(MIXTURE, structure=structure)
    model = METHOD.new_model(recipe, None, torch.Generator().manual_seed(seed)).eval()
    embedding = torch.rand((1, 256), generator=torch.Generator().manual_seed(seed))
    body = body_for(recipe, GROUPS[structure](), torch.device("cpu"))
    with torch.no_grad():
        for name, first in (("axes", 2), ("poses", 3)):
            count = getattr(heads_of(recipe), name)
            if count:
                at = sum(heads_of(recipe).numbers[:first])
                size = 13 if name == "poses" else 10
                for one in range(count):
                    model.output.bias[at + one * size + 6 : at + one * size + (9 if size == 13 else 8)] += narrower
        told = model.told(embedding, is_directed=body.is_directed)
        return Densities(model, structure, body, calibration or Calibration()).of_image(told, 0), body


@pytest.mark.parametrize("structure", GROUPS)
@torch.no_grad()
def test_what_is_claimed_on_the_grid_is_what_is_claimed_of_each_of_its_rotations(structure):
    found, _ = density(structure)
    grid = grid_of(LEVEL)
    near, at = found.claimed_on(grid)
    everywhere = found.log_claim(grid.rotations)
    assert torch.allclose(at, everywhere[near], atol=1e-3)
    left_out = np.setdiff1d(np.arange(len(grid)), near)
    assert len(left_out) > 0
    assert (everywhere[left_out] < -np.log(9.0)).all()  # under the floor of 0.1 that a file lists


@pytest.mark.parametrize("structure", GROUPS)
@torch.no_grad()
def test_cells_hold_the_density_averaged_over_them(structure):
    found, _ = density(structure, narrower=1.0)
    of_cells = found.on_cells(grid_of(LEVEL)).exp()
    assert float(of_cells.mean()) == pytest.approx(1.0, abs=0.12)
    finer = grid_of(LEVEL + 2)
    inside = torch.from_numpy(cell_of(finer.index.rotations, LEVEL))
    averages = torch.zeros(len(of_cells)).index_add_(0, inside, found.log_density(finer.rotations).exp())
    averages /= torch.bincount(inside, minlength=len(of_cells))
    at_middles = found.log_density(grid_of(LEVEL).rotations).exp()
    close, closest = (np.corrcoef(of, averages)[0, 1] for of in (at_middles, of_cells))
    assert closest > max(0.9, close)


@pytest.mark.parametrize("narrower", [0.0, 3.0])
@torch.no_grad()
def test_cells_that_a_file_lists_hold_the_whole_mixture_of_broad_and_narrow_components(narrower):
    found, _ = density("free", narrower=narrower)
    grid = grid_of(LEVEL)
    roots = found.mixture.roots.clone()
    roots[:, 0] /= 40.0  # one of the components is broad
    found.__dict__["mixture"] = replace(found.mixture, roots=roots)
    whole = found.mixture.blurred(grid.blur_rad).log_density(grid.rotations)[0]
    of_cells = found.on_cells(grid)
    listed = whole > np.log(LEAST_CELL * len(grid))
    assert listed.any()
    assert torch.allclose(of_cells[listed].exp(), whole[listed].exp(), rtol=0.05, atol=1e-3)


@pytest.mark.parametrize("structure", ["group", "circle", "marked-circle"])
@torch.no_grad()
def test_the_density_is_the_bodys_where_nothing_marks_it(structure):
    found, body = density(structure)
    R = grid_of(0).rotations[:9]
    turned = found.log_density((R[:, None] @ body.group[::7]).flatten(0, 1)).reshape(9, -1)
    spread = (turned - found.log_density(R)[:, None]).abs().max()
    assert (spread < 5e-3) == (structure != "marked-circle")


@pytest.mark.parametrize("structure", GROUPS)
@torch.no_grad()
def test_hypotheses_are_rotations_that_the_density_holds_likely(structure):
    found, _ = density(structure)
    hypotheses = found.hypotheses()
    assert np.allclose(hypotheses @ np.swapaxes(hypotheses, 1, 2), np.eye(3), atol=1e-5)
    uniform = found.log_density(grid_of(1).rotations).median()
    assert (found.log_density(torch.from_numpy(hypotheses).float()) > uniform + 0.5).float().mean() > 0.6


@pytest.mark.parametrize("structure", GROUPS)
@torch.no_grad()
def test_samples_are_drawn_from_the_density(structure):
    found, _ = density(structure, narrower=-1.0)
    drawn, grid = torch.from_numpy(found.samples(4000)).float(), grid_of(LEVEL + 1).rotations
    assert torch.allclose(drawn @ drawn.mT, torch.eye(3), atol=1e-4)
    p = found.log_density(grid).double().exp()
    least = float(np.log(np.quantile(p, 0.9)))
    is_dense = found.log_density(grid) > least
    held = float(p[is_dense].sum() / p.sum())
    assert float((found.log_density(drawn) > least).float().mean()) == pytest.approx(held, abs=0.1)


@pytest.mark.parametrize("structure", GROUPS)
@torch.no_grad()
def test_covering_hypotheses_leave_less_out(structure):
    found, _ = density(structure)
    likely = found.samples(600)
    few, many = found.listed(BALANCED), found.listed(COVERING)
    assert len(many) == 180
    assert np.allclose(many[: len(few)], few)
    assert nearest_angles(likely, many).mean() < 0.9 * nearest_angles(likely, few).mean()


@torch.no_grad()
def test_a_body_with_many_symmetries_needs_no_samples_to_cover_its_set(monkeypatch):
    monkeypatch.setitem(GROUPS, "group", icosahedral_group)
    found, _ = density("group")
    assert len(found.hypotheses()) >= 180
    assert np.array_equal(found.listed(COVERING), found.hypotheses()[:180])


@pytest.mark.parametrize("structure", ["free", "group", "circle"])
@torch.no_grad()
def test_the_surest_hypothesis_is_where_the_density_is_highest(structure):
    found, _ = density(structure)
    at = [found.log_density(torch.from_numpy(found.listed(which)).float()) for which in (BALANCED, SUREST)]
    assert len(at[1]) == 1
    assert at[1][0] >= at[0].max() - 1e-3


@pytest.mark.parametrize("probability_shown", [0.0, 0.5, 1.0])
@torch.no_grad()
def test_the_surest_turn_of_a_marking_errs_least_whether_it_shows_or_not(probability_shown):
    found, body = density("marked-circle")
    found.__dict__["probability_shown"] = probability_shown
    R = torch.from_numpy(found.listed(SUREST)).float() @ body.group  # the identity first
    share, is_hidden = torch.softmax(found.pose.of_image(R), 0), found._views.logit(R) > 0
    angles = np.stack([nearest_angles(R.numpy(), one[None].numpy()) for one in R])
    expected = probability_shown * angles @ share.numpy()
    assert is_hidden.any()
    expected += (1.0 - probability_shown) * angles[:, is_hidden].min(axis=1)
    assert expected[0] == pytest.approx(expected.min(), abs=5e-3)


@pytest.mark.parametrize("structure", GROUPS)
@torch.no_grad()
def test_nothing_is_said_of_no_rotations(structure):
    found, _ = density(structure)
    nothing = torch.zeros((0, 3, 3))
    assert found.log_density(nothing).shape == found.log_claim(nothing).shape == (0,)


@torch.no_grad()
def test_a_sure_density_that_claims_nothing_on_a_coarse_grid_says_so():
    found, _ = density("marked-circle", narrower=9.0, calibration=Calibration(axis_precision=9.0))
    for shows in (True, False):
        found.__dict__["takes_it_for_shown"] = shows
        near, at = found.claimed_on(grid_of(0))
        assert len(near) == len(at) == 0  # its axis lies between those of the grid


def test_a_climb_ends_where_both_neighbours_are_lower_and_asks_of_each_value_once():
    asked = []

    def ask(value):
        asked.append(value)
        return -abs(value - 3.0), f"answer {value}"

    assert climb((0.5, 1.0, 2.0, 2.9, 4.0, 8.0), ask) == (-abs(2.9 - 3.0), "answer 2.9")
    assert sorted(asked) == [0.5, 1.0, 2.0, 2.9, 4.0]
    assert climb((0.5, 1.0), lambda value: (0.0, value)) == (0.0, 1.0)  # no better, no step
    assert climb((0.25, 0.5, 1.0), lambda value: (-value, value)) == (-0.25, 0.25)


@torch.no_grad()
def test_calibration_moves_the_threshold_and_the_precision():
    plain, _ = density("free")
    higher, _ = density("free", calibration=Calibration(threshold=2.0))
    sharper, _ = density("free", calibration=Calibration(precision=4.0))
    R = grid_of(1).rotations
    assert torch.allclose(plain.log_claim(R) - higher.log_claim(R), torch.tensor(2.0).log(), atol=1e-4)
    centre = torch.from_numpy(plain.hypotheses()[:1]).float()
    assert sharper.log_density(centre) - plain.log_density(centre) == pytest.approx(np.log(8.0), abs=0.01)  # 4^1.5


@pytest.mark.parametrize(("name", "structure"), [("tetX", "free"), ("tet", "group"), ("cyl", "circle")])
def test_one_training_answers_all_three_tracks_and_keeps_what_it_fitted(name, structure, tmp_path):
    make_set(tmp_path / "data", name, train=12, test=2, size=16, annotate="all")
    recipe = replace(MIXTURE, structure=structure, epochs=1, learning_rates=(1e-3,), milestones=(), rolls=True)
    with load(tmp_path / "data" / name, "train") as images:
        record = train(recipe, images, tmp_path / "run", CPU, name="mine")
    assert set(record.calibration) == {*Calibration().to_record(), "f_measure"}
    checkpoint = open_checkpoint(tmp_path / "run")
    assert checkpoint.record.calibration == record.calibration
    with load(tmp_path / "data" / name) as test:
        path, device = tmp_path / "preds.h5", torch.device("cpu")
        assert predict(checkpoint, test, path, device, level=1) == ("hypotheses", "classifier", "density")
    assert set(score_file(path, tmp_path / "data").tracks) == {"hypotheses", "classifier", "density"}


def test_a_structure_that_does_not_fit_the_body_is_refused_before_training(tmp_path):
    make_set(tmp_path, "tetX", train=12, test=1, size=16, annotate="all")
    recipe = replace(MIXTURE, structure="marked-circle")
    with load(tmp_path / "tetX", "train") as images, pytest.raises(SettingsError, match=r"structure: 'marked-circle'"):
        train(recipe, images, tmp_path / "run", CPU)
    assert not list((tmp_path / "run").glob("*.safetensors"))


@torch.no_grad()
def test_what_views_hide_the_marking_is_asked_of_the_weights_as_they_are():
    """Over the body's group, h(R g) relative to its mean has the mean 1, also after another epoch changed h."""
    recipe = replace(MIXTURE, structure="marked-circle")
    model = METHOD.new_model(recipe, None, torch.Generator().manual_seed(0)).eval()
    body = body_for(recipe, dihedral_group(360), torch.device("cpu"))
    told = model.told(torch.rand((1, 256)), is_directed=False)
    R = (grid_of(0).rotations[:20, None] @ body.group).flatten(0, 1)
    for _ in range(2):
        density = Densities(model, "marked-circle", body, Calibration()).of_image(told, 0)
        means = density._views.log_relative(R).reshape(20, -1).exp().mean(1)
        assert torch.allclose(means, torch.ones(20), atol=0.02)
        model.view[0].weight *= -3.0
        model.view[4].bias -= 2.0
