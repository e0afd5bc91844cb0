"""Retrieval: views are found in any quarter turn, densities are those of the formulas, files hold what was found."""

import h5py
import numpy as np
import pytest
import torch
from made_sets import make_set

from symsol_annot.bench.models.batches import Batch, reduced, rolled
from symsol_annot.bench.models.retrieval import retrieval
from symsol_annot.bench.models.retrieval.embedding import COLOUR_WEIGHT, embed, embed_dataset
from symsol_annot.bench.models.retrieval.fitting import fit_bandwidths
from symsol_annot.bench.models.retrieval.retrieval import retrieve
from symsol_annot.bench.models.retrieval.view_density import (
    Bandwidths,
    Cells,
    ClaimRule,
    ViewDensity,
    kernel,
    weights_of,
)
from symsol_annot.bench.models.retrieval.view_index import NearViews, ViewIndex
from symsol_annot.bench.scoring.reports import report, tables
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import DataError, SettingsError
from symsol_annot.rotations.grid import GridIndex
from symsol_annot.rotations.so3 import angle_between, rotations_about, uniform_rotations
from symsol_annot.sets.dataset import load

torch.set_num_threads(1)
WIDTHS = Bandwidths(angle_rad=0.2, uniform=0.01, factor=1.0, own_share=0.0, median_distance=1.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A set of tetX, both splits with symmetry sets."""
    return make_set(tmp_path_factory.mktemp("retrieval") / "data", "tetX", train=60, test=4, size=32, annotate="all")


@pytest.fixture(scope="module")
def train(folder):
    return load(folder, "train")


def test_embeddings_are_area_means_in_which_colour_weighs_more(train):
    images = np.stack([train[i].image for i in range(3)])
    means = torch.nn.functional.adaptive_avg_pool2d(torch.from_numpy(images).permute(0, 3, 1, 2).float(), 12)
    means = means.permute(0, 2, 3, 1).numpy() / 255.0
    grey = means.mean(axis=-1, keepdims=True)
    np.testing.assert_allclose(embed(images, 12), grey + COLOUR_WEIGHT * (means - grey), atol=2e-6)
    assert reduced(torch.from_numpy(images), 12).shape == embed(images, 12).shape


def test_a_rolled_train_image_is_found_with_its_rotation(train):
    samples = [train[i] for i in range(8)]
    images = torch.from_numpy(np.stack([sample.image for sample in samples]))
    batch = rolled(Batch(images, torch.from_numpy(np.stack([sample.rotation for sample in samples]))))
    known, R_gt = embed_dataset(train, 16)
    found = ViewIndex(known, R_gt).nearest(embed(batch.images.numpy(), 16), 3)
    np.testing.assert_allclose(found.distance[:, 0], 0.0, atol=1e-4)
    np.testing.assert_allclose(found.rotation[:, 0], batch.R_gt.numpy(), atol=1e-6)
    assert (np.diff(found.distance, axis=1) >= 0).all()
    in_one_turn = ViewIndex(known, R_gt, turns=1).nearest(embed(batch.images.numpy(), 16), 1)
    assert (in_one_turn.distance[2:, 0] > 0.1).all()  # turned ones are other images then


def test_distances_are_those_of_all_views_in_all_turns(train):
    known, R_gt = embed_dataset(train, 8)
    found = ViewIndex(known[1:], R_gt[1:]).nearest(known[:1], 1000)
    turned = np.stack([np.rot90(known[0], -turn) for turn in range(4)])
    every = np.linalg.norm((turned[:, None] - known[None, 1:]).reshape(4, len(known) - 1, -1), axis=2)
    np.testing.assert_allclose(found.distance[0], np.sort(every.ravel()), atol=1e-4)


def test_a_view_that_is_left_out_is_found_in_no_turn(train):
    known, R_gt = embed_dataset(train, 8)
    rows = np.arange(5)
    found = ViewIndex(known, R_gt).nearest(known[rows], 4 * len(known), left_out=rows)
    assert found.distance.shape == (5, 4 * (len(known) - 1))
    assert np.isfinite(found.distance).all()
    assert (found.distance[:, 0] > 0.01).all()
    for i in rows:
        own = rotations_about((0, 0, 1), np.pi / 2 * np.arange(4)) @ R_gt[i]
        assert (np.abs(found.rotation[i][:, None] - own).max(axis=(2, 3)) > 1e-6).all()


@pytest.mark.parametrize("bandwidth_rad", [0.03, 0.3, 1.0])
def test_the_kernel_has_the_uniform_densitys_mass(bandwidth_rad):
    angle = np.linspace(0.0, np.pi, 200_001)
    of_angle = kernel(np.cos(angle) - 1.0, bandwidth_rad) * (1.0 - np.cos(angle)) / np.pi
    assert of_angle.sum() * (angle[1] - angle[0]) == pytest.approx(1.0, abs=1e-5)


def test_a_density_is_the_weighted_kernels_and_the_uniform_share():
    rng = np.random.default_rng(0)
    R, asked, weights = uniform_rotations(5, rng), uniform_rotations(50, rng), np.array([0.4, 0.3, 0.2, 0.1, 0.0])
    angles = angle_between(asked[:, None], R)
    expected = 0.01 + 0.99 * (kernel(np.cos(angles) - 1.0, 0.2) * weights).sum(axis=1)
    density = ViewDensity(R, weights, WIDTHS)
    np.testing.assert_allclose(density.log_density(asked), np.log(expected), atol=1e-9)
    cells = Cells(2)
    near, log_p = density.near(cells)
    np.testing.assert_allclose(log_p, density.log_density(cells.index.rotations[near]), atol=1e-9)
    beyond = np.setdiff1d(np.arange(len(cells)), near)
    assert (density.log_density(cells.index.rotations[beyond]) < np.log(0.15)).all()
    assert np.exp(density.on_cells(cells)).mean() == pytest.approx(1.0, abs=0.02)


def test_weights_fall_with_distance_by_one_width_or_each_images_own():
    distance = np.array([[1.0, 2.0], [10.0, 20.0]])
    one, own = (Bandwidths(1.0, 0.1, 1.0, share, 2.0) for share in (0.0, 1.0))
    np.testing.assert_allclose(weights_of(distance, one)[0, 1] / weights_of(distance, one)[0, 0], np.exp(-3 / 8))
    of_own = weights_of(distance, own)
    np.testing.assert_allclose(of_own[0], of_own[1])
    assert weights_of(distance, one)[1, 1] < of_own[1, 1]


def test_hypotheses_are_nearest_first_and_three_degrees_apart():
    R = rotations_about((0, 0, 1), np.radians([0.0, 1.0, 4.0, 5.0, 8.0, 0.5]))
    found = ViewDensity(R, np.full(6, 1 / 6), WIDTHS).hypotheses()
    np.testing.assert_array_equal(found, R[[0, 2, 4]])
    many = ViewDensity(uniform_rotations(200, np.random.default_rng(0)), np.full(200, 1 / 200), WIDTHS).hypotheses()
    assert len(many) == 30


def test_fitted_bandwidths_are_those_that_made_the_views():
    rng = np.random.default_rng(1)
    R_gt = uniform_rotations(400, rng)
    axes = rng.normal(size=(400, 1, 3))
    angle = np.linalg.norm(axes, axis=2)  # of an isotropic normal with deviation 1
    off = np.stack([rotations_about(v, 0.1 * a) for v, a in zip(axes[:, 0], angle[:, 0], strict=True)])[:, None]
    views = NearViews(R_gt[:, None] @ off, np.ones((400, 1)))
    fitted, mean = fit_bandwidths(views, R_gt)
    assert fitted.angle_rad == pytest.approx(0.1, rel=0.15)
    assert fitted.uniform < 0.01
    assert mean > 4.0


def test_the_file_holds_what_the_nearest_views_say(folder, train, tmp_path):
    test = load(folder)
    done = retrieve(test, train, tmp_path / "preds.h5", level=1)
    assert done.tracks == ("hypotheses", "classifier", "density")
    known, R_gt = embed_dataset(train, 16)
    asked, _ = embed_dataset(test, 16)
    views = ViewIndex(known, R_gt).nearest(asked, 128)
    weights, grid = weights_of(views.distance, done.bandwidths), GridIndex(1)
    with h5py.File(tmp_path / "preds.h5") as file:
        assert file.attrs["method"] == "retrieval"
        for i in range(len(test)):
            density = ViewDensity(views.rotation[i], weights[i], done.bandwidths)
            np.testing.assert_allclose(file["hypotheses"][i, 0], views.rotation[i, 0], atol=1e-12)
            start, end = file["grid_offsets"][i : i + 2]
            log_t = density.log_threshold(done.rule)
            claimed = file["grid_indices"][start:end][file["grid_probabilities"][start:end] > 0.8]
            near, log_p = density.near(Cells(1))
            np.testing.assert_array_equal(claimed, near[log_p > log_t])
            start, end = file["density_offsets"][i : i + 2]
            log_cells = np.full(len(grid), np.nan)
            log_cells[file["density_indices"][start:end]] = file["density_log_probabilities"][start:end]
            expected = density.on_cells(Cells(1))
            expected -= np.log(np.exp(expected).sum())
            listed = ~np.isnan(log_cells)
            np.testing.assert_allclose(log_cells[listed], expected[listed], atol=1e-5)
    document = report.to_document([score_file(tmp_path / "preds.h5", test.folder)])
    assert "tetX" in tables.tables(document)


def test_the_same_call_goes_on_with_what_is_left(folder, train, tmp_path, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(retrieval, "write_cells", stop)
        with pytest.raises(KeyboardInterrupt):
            retrieve(load(folder), train, tmp_path / "stopped.h5", level=0)
    retrieve(load(folder), train, tmp_path / "stopped.h5", level=0)
    retrieve(load(folder), train, tmp_path / "whole.h5", level=0)
    with h5py.File(tmp_path / "stopped.h5") as one, h5py.File(tmp_path / "whole.h5") as other:
        assert set(one) == set(other)
        for name in one:
            np.testing.assert_array_equal(one[name], other[name])


def test_without_symmetry_sets_of_views_there_are_no_claims(tmp_path):
    bare = make_set(tmp_path / "data", "tetX", train=20, test=2, size=16)
    done = retrieve(load(bare), load(bare, "train"), tmp_path / "preds.h5", level=0)
    assert (done.tracks, done.rule, done.f_measure) == (("hypotheses", "density"), None, None)
    with h5py.File(tmp_path / "preds.h5") as file:
        assert "query_probability" not in file


def test_views_that_cannot_answer_are_refused(folder, train, tmp_path):
    path = tmp_path / "preds.h5"
    cones = make_set(tmp_path / "cones", "cone", train=8, test=0, size=16, annotate="none")
    few = make_set(tmp_path / "few", "tetX", train=3, test=0, size=16, annotate="none")
    with pytest.raises(DataError, match=r"expected views of tetX, which .* is a set of, found cone"):
        retrieve(load(folder), load(cones, "train"), path)
    with pytest.raises(DataError, match="the views are the images that are asked about"):
        retrieve(load(folder), load(folder), path)
    with pytest.raises(DataError, match="expected at least 8 train images to search, found 3; render more with"):
        retrieve(load(folder), load(few, "train"), path)
    with pytest.raises(SettingsError, match="size: expected 1 to 32 for images of 32 pixels, found 33"):
        retrieve(load(folder), train, path, size=33)
    assert not path.exists()


def test_a_claim_rule_follows_the_peak():
    density = ViewDensity(np.eye(3)[None], np.ones(1), WIDTHS)
    assert density.log_peak == pytest.approx(float(density.log_density(np.eye(3)[None])[0]))
    assert density.log_threshold(ClaimRule(1.0, 0.5)) == pytest.approx(1.0 + 0.5 * density.log_peak)
