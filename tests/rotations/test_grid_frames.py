"""The grid in the frames of others, and in HEALPix's other order."""

import math

import numpy as np
import pytest
from grid_tables import angles_of, directions_of, grid_of, levels_to, turn_y, turn_z, uniform
from hypothesis import given, settings
from hypothesis import strategies as st

from symsol_annot.rotations import grid

angles = st.floats(-10, 10)


def turn_x(angle):
    return np.array([[1, 0, 0], [0, math.cos(angle), -math.sin(angle)], [0, math.sin(angle), math.cos(angle)]])


# --- the frames of others ---


def implicit_pdf_grid(level):
    """As google-research/implicit_pdf generates it: about x by the azimuth, z by the polar angle, x by the tilt."""
    return np.stack([turn_x(azimuth) @ turn_z(polar) @ turn_x(tilt) for azimuth, polar, tilt in angles_of(level)])


def e3nn_grid(level):
    """As its users generate it: alpha azimuth, beta polar, gamma tilt, and e3nn's Ry(alpha) Rx(beta) Ry(gamma)."""
    return np.stack([turn_y(alpha) @ turn_x(beta) @ turn_y(gamma) for alpha, beta, gamma in angles_of(level)])


FRAMES = {
    "Implicit-PDF": (implicit_pdf_grid, grid.implicit_pdf_to_grid_frame, grid.grid_frame_to_implicit_pdf),
    "e3nn": (e3nn_grid, grid.e3nn_to_grid_frame, grid.grid_frame_to_e3nn),
}
every_frame = pytest.mark.parametrize("frame", FRAMES)


@every_frame
@levels_to[2]
def test_grid_of_others_is_this_grid_index_by_index(frame, level):
    theirs, to_ours, to_theirs = FRAMES[frame]
    np.testing.assert_allclose(to_ours(theirs(level)), grid_of(level), atol=1e-14)
    np.testing.assert_allclose(to_theirs(grid_of(level)), theirs(level), atol=1e-14)


@every_frame
def test_conversion_there_and_back_changes_nothing(frame):
    _, to_ours, to_theirs = FRAMES[frame]
    R = uniform(60).reshape(3, 4, 5, 3, 3)
    np.testing.assert_array_equal(to_ours(to_theirs(R)), R)
    np.testing.assert_array_equal(to_theirs(to_ours(R)), R)
    np.testing.assert_array_equal(to_ours(R[1, 2, 3]), to_ours(R)[1, 2, 3])


@every_frame
def test_conversion_keeps_products_and_is_no_identity(frame):
    _, to_ours, to_theirs = FRAMES[frame]
    a, b = uniform(20, seed=1), uniform(20, seed=2)
    for convert in (to_ours, to_theirs):
        np.testing.assert_allclose(convert(a) @ convert(b), convert(a @ b), atol=1e-14)
        assert np.abs(convert(a) - a).max() > 0.1
    assert np.abs(to_ours(a) - to_theirs(a)).max() > 0.1


@given(first=angles, second=angles, third=angles)
@settings(deadline=None, max_examples=40)
def test_euler_angles_of_others_are_ours_about_our_axes(first, second, third):
    ours = turn_z(first) @ turn_y(second) @ turn_z(third)
    implicit_pdf = turn_x(first) @ turn_z(second) @ turn_x(third)
    e3nn = turn_y(first) @ turn_x(second) @ turn_y(third)
    np.testing.assert_allclose(grid.implicit_pdf_to_grid_frame(implicit_pdf), ours, atol=1e-14)
    np.testing.assert_allclose(grid.e3nn_to_grid_frame(e3nn), ours, atol=1e-14)


# --- HEALPix's other order ---


def nested_direction(n_side, pixel):
    """The centre of a nested pixel as a unit vector (Gorski et al., 2005, sections 4 and 5)."""
    face, inside = divmod(pixel, n_side**2)
    bits = range(n_side.bit_length())
    x = sum((inside >> 2 * bit & 1) << bit for bit in bits)
    y = sum((inside >> 2 * bit + 1 & 1) << bit for bit in bits)
    row, column = divmod(face, 4)
    ring = (row + 2) * n_side - x - y - 1
    pixels_a_quarter = min(ring, n_side, 4 * n_side - ring)
    from_pole = pixels_a_quarter**2 / (3 * n_side**2)
    belt_z = 4 / 3 - 2 * ring / (3 * n_side)
    z = 1 - from_pole if ring < n_side else belt_z if ring <= 3 * n_side else from_pole - 1
    azimuth = math.pi / (2 * pixels_a_quarter) * ((2 * column - row % 2 + 1) * pixels_a_quarter + x - y) / 2
    return [math.sqrt(1 - z * z) * math.cos(azimuth), math.sqrt(1 - z * z) * math.sin(azimuth), z]


@levels_to[3]
def test_nested_index_has_the_same_tilt_and_its_nested_pixel_the_same_direction(level):
    directions = directions_of(level)
    centres = np.array([nested_direction(2**level, pixel) for pixel in range(directions)])
    nested = grid.ring_to_nested(level)
    np.testing.assert_array_equal(nested // directions, np.arange(len(nested)) // directions)
    np.testing.assert_allclose(centres[nested % directions], grid_of(level)[:, :, 2], atol=1e-14)


@levels_to[4]
def test_nested_order_is_a_permutation(level):
    nested = grid.ring_to_nested(level)
    assert nested.dtype == np.int64
    np.testing.assert_array_equal(np.sort(nested), np.arange(grid.grid_size(level)))


def test_nested_order_of_two_pixels_a_side_starts_as_healpy_documents_it():
    assert grid.ring_to_nested(1)[:10].tolist() == [3, 7, 11, 15, 2, 1, 6, 5, 10, 9]
    np.testing.assert_array_equal(grid.ring_to_nested(0), np.arange(72))
