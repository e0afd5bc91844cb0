"""What a member on a circle has to share with an image: surfaces in sight, and rims in sight."""

from dataclasses import replace

import numpy as np
import pytest
from mesh_renderer import MeshRenderer, N
from parted_objects import TOML, mug, painted, parted_toml

from symsol_annot.annotation.continuous_limit import have_the_same, what_is_seen
from symsol_annot.objects.spec import read_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rotations.so3 import rotations_about

CAMERA, FACETS, STRIPE = Camera.filling(16), 36, range(8)
CIRCLE = f'kind = "cyclic"\norder = {FACETS}'
UPRIGHT = rotations_about([1, 0, 0], np.array([np.pi / 2]))[0]  # z up; the direction -y towards the camera


def facing_facet(facet):
    """The prism upright, with a side face towards the camera: face 0 looks along x turned by one facet."""
    return UPRIGHT @ rotations_about([0, 0, 1], np.array([-np.pi / 2 - (facet + 1) * 2 * np.pi / FACETS]))[0]


@pytest.fixture(scope="module")
def striped(tmp_path_factory):
    """A prism with a stripe of eight faces, and a caster of rays."""
    folder = tmp_path_factory.mktemp("striped")
    parts = [("body", "clay", None), ("stripe", "paint", (0.9, 0.1, 0.1))]
    (folder / "object.toml").write_text(parted_toml(parts, CIRCLE))
    (folder / "mesh.obj").write_text(painted(*((k, "paint") for k in STRIPE), facets=FACETS))
    spec = read_object(folder)
    return spec, MeshRenderer(spec, CAMERA)


def seen_at(striped, R):
    spec, renderer = striped
    return what_is_seen(spec.mesh, R, renderer.lit_windows(R[None])[0], CAMERA.lattice(N))


def test_points_seen_lie_on_the_part_and_on_the_border_that_faces_the_camera(striped):
    (stripe,) = seen_at(striped, facing_facet(3))
    assert stripe.part == 2
    assert 10 < len(stripe.surface) <= 24
    assert 10 < len(stripe.rim) <= 24
    apothem = 0.8 * np.cos(np.pi / FACETS)
    outwards = [[np.cos(a), np.sin(a), 0] for a in 2 * np.pi * (np.arange(FACETS) + 1) / FACETS]
    on_faces = np.abs(stripe.surface @ np.transpose(outwards) - apothem) < 1e-9
    assert on_faces[:, : len(STRIPE)].any(axis=1).all()
    ends = (
        np.abs(np.abs(stripe.rim[:, 2]) - 0.6) < 1e-9
    )  # the borders above and below; the others are at the stripe's ends
    assert ends.any()
    assert np.allclose(np.hypot(*stripe.rim[~ends, :2].T), 0.8)


def test_a_stripe_of_which_an_end_shows_has_no_neighbours(striped):
    """From beside the stripe, its last faces are at the horizon, and the same surface is there a few turns on."""
    spec, _ = striped
    (beside,) = seen_at(striped, facing_facet(len(STRIPE) + 5))
    assert have_the_same(spec.mesh, [beside], spec.symmetry_group).tolist() == [True] + (FACETS - 1) * [False]
    without_rim = replace(beside, rim=np.zeros((0, 3)))
    assert have_the_same(spec.mesh, [without_rim], spec.symmetry_group).sum() > 1  # the rim decides, not the surface


def test_where_nothing_of_a_part_is_seen_nothing_is_the_same(striped):
    spec, _ = striped
    behind = seen_at(striped, facing_facet(22))
    assert behind == []
    assert not have_the_same(spec.mesh, behind, spec.symmetry_group).any()


def test_a_part_that_is_a_closed_surface_has_no_rim(tmp_path):
    (tmp_path / "object.toml").write_text(TOML)
    (tmp_path / "mesh.obj").write_text(mug())
    spec = read_object(tmp_path)
    renderer, R = MeshRenderer(spec, CAMERA), facing_facet(0)
    (handle,) = what_is_seen(spec.mesh, R, renderer.lit_windows(R[None])[0], CAMERA.lattice(N))
    assert len(handle.rim) == 0
    assert have_the_same(spec.mesh, [handle], spec.symmetry_group)[0]
