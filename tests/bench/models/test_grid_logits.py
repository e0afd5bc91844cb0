"""Logits on the grid: worked out where they matter, and those of the grid below elsewhere."""

import numpy as np
import pytest
import torch
from reference_models import seeded

from symsol_annot.bench.models import RotationClassifier
from symsol_annot.bench.models.networks.grid_logits import GridLogits
from symsol_annot.rotations.grid import equivolumetric_grid, grid_index

LEVEL = 2


@pytest.fixture(scope="module")
def asked():
    """A network whose logits differ by some ten, an embedding, and its logits on the grids of two levels."""
    model = RotationClassifier(pretrained=None, rng=seeded(0)).eval()
    with torch.no_grad():
        model.second_stage.logit.weight *= 60.0
    embedding = torch.rand(256, generator=seeded(1))
    fine, coarse = (
        model.logits(embedding[None], torch.from_numpy(equivolumetric_grid(level)).float())[0].detach()
        for level in (LEVEL, LEVEL - 1)
    )
    return GridLogits(model, LEVEL), embedding, fine, coarse


def nearest_below():
    return torch.from_numpy(grid_index(LEVEL - 1).nearest(equivolumetric_grid(LEVEL)))


def test_everywhere_they_are_the_network_s(asked):
    on_grid, embedding, fine, _ = asked
    assert fine.max() - fine.min() > 10.0
    torch.testing.assert_close(on_grid.everywhere(embedding), fine)
    torch.testing.assert_close(on_grid.above(embedding, -np.inf), fine)
    torch.testing.assert_close(on_grid.below_highest(embedding, np.inf), fine)


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_what_matters_is_the_network_s_and_the_rest_the_neighbour_s(asked, share):
    on_grid, embedding, fine, coarse = asked
    least = float(coarse.quantile(1.0 - share))
    of_neighbour = coarse[nearest_below()]
    expected = torch.where(of_neighbour >= least, fine, of_neighbour)
    assert (expected != fine).any()
    torch.testing.assert_close(on_grid.above(embedding, least), expected)
    torch.testing.assert_close(on_grid.below_highest(embedding, float(coarse.max()) - least), expected)


def test_where_most_of_the_grid_matters_all_of_it_is_asked(asked):
    on_grid, embedding, fine, coarse = asked
    torch.testing.assert_close(on_grid.above(embedding, float(coarse.quantile(0.2))), fine)


def test_nothing_that_matters_is_the_grid_below(asked):
    on_grid, embedding, _, coarse = asked
    torch.testing.assert_close(on_grid.above(embedding, np.inf), coarse[nearest_below()])


def test_the_lowest_grid_has_none_below_and_is_asked_as_a_whole(asked):
    _, embedding, _, _ = asked
    model = RotationClassifier(pretrained=None, rng=seeded(0)).eval()
    whole = model.logits(embedding[None], torch.from_numpy(equivolumetric_grid(0)).float())[0].detach()
    torch.testing.assert_close(GridLogits(model, 0).above(embedding, np.inf), whole)
    torch.testing.assert_close(GridLogits(model, 0).below_highest(embedding, 0.0), whole)
