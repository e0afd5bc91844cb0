"""Finite groups of rotations: they are groups, scipy's, with their elements found and their cosets a partition."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rotation_strategies import axes
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from symsol_annot.errors import RotationError
from symsol_annot.rotations.group_laws import check_group
from symsol_annot.rotations.groups import (
    GROUP_KINDS,
    cyclic_group,
    dihedral_group,
    icosahedral_group,
    left_cosets,
    nearest_element,
    octahedral_group,
    tetrahedral_group,
)

GOLDEN = (1 + 5**0.5) / 2
GROUPS = {
    "tetrahedral": (tetrahedral_group, 12, "T"),
    "octahedral": (octahedral_group, 24, "O"),
    "icosahedral": (icosahedral_group, 60, "I"),
    "cyclic 360": (lambda: cyclic_group(360), 360, "C360"),
    "dihedral 360": (lambda: dihedral_group(360), 720, "D360"),
}
every_group = pytest.mark.parametrize("name", GROUPS)
quick = settings(deadline=None, max_examples=60)


def group_called(name):
    return GROUPS[name][0]()


def distance_to_nearest(elements, matrices):
    """For each of (..., 3, 3) matrices the largest entry's distance to the nearest element of (n, 3, 3)."""
    tree = cKDTree(elements.reshape(-1, 9))
    return tree.query(matrices.reshape(-1, 9), p=np.inf)[0]


# --- groups ---


@every_group
def test_group_has_its_order_and_counts_no_element_twice(name):
    group = group_called(name)
    assert group.shape == (GROUPS[name][1], 3, 3)
    nearest_two = cKDTree(group.reshape(-1, 9)).query(group.reshape(-1, 9), k=2)[0]
    assert nearest_two[:, 1].min() > 0.01


@every_group
def test_group_starts_with_the_identity(name):
    np.testing.assert_array_equal(group_called(name)[0], np.eye(3))


@every_group
def test_group_is_closed_under_products_and_inverses(name):
    group = group_called(name)
    products = np.einsum("aij,bjk->abik", group, group)
    assert distance_to_nearest(group, products).max() < 1e-12
    assert distance_to_nearest(group, np.swapaxes(group, 1, 2)).max() < 1e-12


@every_group
def test_group_holds_only_rotations(name):
    group = group_called(name)
    assert np.abs(np.einsum("aji,ajk->aik", group, group) - np.eye(3)).max() < 1e-14
    np.testing.assert_allclose(np.linalg.det(group), 1, atol=1e-14)


@every_group
def test_group_is_the_one_that_scipy_builds_about_the_same_axes(name):
    expected = Rotation.create_group(GROUPS[name][2], axis="Z").as_matrix()
    assert distance_to_nearest(group_called(name), expected).max() < 1e-12


def test_cyclic_group_of_360_steps_by_exactly_one_degree_and_closes_with_the_same_step():
    group = cyclic_group(360)
    steps = Rotation.from_matrix(np.swapaxes(group, 1, 2) @ np.roll(group, -1, axis=0)).as_rotvec(degrees=True)
    np.testing.assert_allclose(steps, np.tile([0, 0, 1], (360, 1)), rtol=0, atol=1e-11)


def test_cyclic_group_leaves_out_the_end_of_the_circle():
    away_from_start = Rotation.from_matrix(cyclic_group(360)[1:]).magnitude()
    assert away_from_start.min() > np.radians(0.999)


@given(order=st.integers(1, 50), axis=axes())
@quick
def test_cyclic_group_turns_counter_clockwise_about_its_axis(order, axis):
    expected = Rotation.from_rotvec(np.outer(2 * np.pi * np.arange(order) / order, axis)).as_matrix()
    np.testing.assert_allclose(cyclic_group(order, axis), expected, atol=1e-13)


def test_axis_of_a_cyclic_group_may_have_any_length():
    np.testing.assert_allclose(cyclic_group(7, [0, 0, 250]), cyclic_group(7), atol=1e-15)


def test_second_half_of_a_dihedral_group_turns_the_z_axis_over():
    group = dihedral_group(360)
    np.testing.assert_allclose(group[:360, 2, 2], 1, atol=1e-15)
    np.testing.assert_allclose(group[360:, 2, 2], -1, atol=1e-15)
    np.testing.assert_allclose(group[360], np.diag([1, -1, -1]), atol=1e-15)


# --- the table of kinds ---


EXAMPLES = {
    "cyclic": ({"order": 6, "axis": (1.0, 0.0, 0.0)}, 6),
    "dihedral": ({"order": 6}, 12),
    "tetrahedral": ({}, 12),
    "octahedral": ({}, 24),
    "icosahedral": ({}, 60),
}


def test_every_kind_makes_a_group_from_the_parameters_that_it_names():
    assert list(GROUP_KINDS) == list(EXAMPLES)
    for name, (parameters, order) in EXAMPLES.items():
        kind = GROUP_KINDS[name]
        assert {*kind.needs, *kind.takes} == set(parameters)
        group = kind.make(**parameters)
        assert len(group) == order
        assert not check_group(group, 1e-9).faults


@pytest.mark.parametrize("kind", GROUP_KINDS.values(), ids=lambda kind: kind.name)
def test_a_kind_needs_no_other_parameters_than_it_says(kind):
    assert len(kind.make(**dict.fromkeys(kind.needs, 4)))


# --- elements and cosets ---


@every_group
def test_nearest_element_finds_every_element_in_any_order(name):
    group = group_called(name)
    order = np.random.default_rng(0).permutation(len(group)).reshape(2, -1)
    np.testing.assert_array_equal(nearest_element(group, group[order]), order)


def test_of_no_rotations_no_element_is_nearest():
    assert nearest_element(cyclic_group(4), np.zeros((0, 3, 3))).shape == (0,)


def test_nearest_element_refuses_a_rotation_from_outside_the_group():
    outside = np.stack([np.eye(3), *cyclic_group(8)[1::2]])
    with pytest.raises(RotationError, match=r"4 of 5 rotations are not among the 12 elements of the group"):
        nearest_element(tetrahedral_group(), outside)


SUBGROUPS = {
    "tetrahedral by a face's turns": (tetrahedral_group, lambda: cyclic_group(3, [1, 1, 1])),
    "octahedral by tetrahedral": (octahedral_group, tetrahedral_group),
    "octahedral by a face's turns": (octahedral_group, lambda: cyclic_group(4, [0, 1, 0])),
    "icosahedral by a corner's turns": (icosahedral_group, lambda: cyclic_group(5, [0, 1, GOLDEN])),
    "cyclic 360 by cyclic 12": (lambda: cyclic_group(360), lambda: cyclic_group(12)),
    "dihedral 360 by cyclic 360": (lambda: dihedral_group(360), lambda: cyclic_group(360)),
    "dihedral 360 by a half turn": (lambda: dihedral_group(360), lambda: cyclic_group(2, [1, 0, 0])),
    "dihedral 360 by the identity": (lambda: dihedral_group(360), lambda: cyclic_group(1)),
    "tetrahedral by itself": (tetrahedral_group, tetrahedral_group),
}
every_subgroup = pytest.mark.parametrize("name", SUBGROUPS)


def cosets_called(name):
    group, subgroup = (make() for make in SUBGROUPS[name])
    return group, subgroup, left_cosets(group, subgroup)


@every_subgroup
def test_cosets_partition_the_group(name):
    group, subgroup, cosets = cosets_called(name)
    assert cosets.shape == (len(group) // len(subgroup), len(subgroup))
    np.testing.assert_array_equal(np.sort(cosets, axis=None), np.arange(len(group)))


@every_subgroup
def test_row_0_of_the_cosets_is_the_subgroup(name):
    group, subgroup, cosets = cosets_called(name)
    np.testing.assert_allclose(group[cosets[0]], subgroup, atol=1e-12)


@every_subgroup
def test_every_row_of_the_cosets_is_any_of_its_elements_times_the_subgroup(name):
    group, subgroup, cosets = cosets_called(name)
    for row in cosets[:: max(1, len(cosets) // 12)]:
        products = np.einsum("aij,hjk->ahik", group[row[:: max(1, len(row) // 12)]], subgroup)
        assert distance_to_nearest(group[row], products).max() < 1e-12


def test_left_cosets_are_not_right_cosets():
    group, subgroup, cosets = cosets_called("tetrahedral by a face's turns")
    swapped = subgroup @ group[cosets[1][0]]
    assert distance_to_nearest(group[cosets[1]], swapped).max() > 0.5


def test_a_subgroup_from_outside_the_group_is_refused():
    with pytest.raises(RotationError, match=r"not among the 12 elements"):
        left_cosets(tetrahedral_group(), cyclic_group(4))


def test_cosets_are_found_without_scipy_which_a_first_picture_would_wait_for():
    code = (
        "import sys; from symsol_annot.objects.spec import load_object;"
        "print(load_object('tetX').cosets.shape, 'scipy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n")[0] == "(4, 3) False"
