"""Whether a list of rotations is a group: decided as by looking at every product, in a small part of the time."""

import time

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from symsol_annot.rotations.group_laws import check_group, right_products
from symsol_annot.rotations.groups import (
    cyclic_group,
    dihedral_group,
    icosahedral_group,
    octahedral_group,
    tetrahedral_group,
)
from symsol_annot.rotations.so3 import rotations_about, uniform_rotations

TOLERANCE = 1e-6
GROUPS = {
    "the identity alone": cyclic_group(1),
    **{f"cyclic {order}": cyclic_group(order) for order in (2, 3, 4, 7, 360)},
    **{f"dihedral {order}": dihedral_group(order) for order in (1, 2, 3, 6, 50)},
    "tetrahedral": tetrahedral_group(),
    "octahedral": octahedral_group(),
    "icosahedral": icosahedral_group(),
}
SMALL = [name for name, group in GROUPS.items() if len(group) <= 60]
SEVERAL = [name for name in SMALL if len(GROUPS[name]) > 2]


def by_all_products(group):
    """Whether a list is a group, from the definition: the identity first, no element twice, every product in it."""
    distance = np.linalg.norm(group[:, None] - group[None], axis=(2, 3))
    products = np.einsum("aij,bjk->abik", group, group).reshape(-1, 1, 3, 3)
    off = np.linalg.norm(products - group, axis=(2, 3)).min(axis=1)
    is_apart = (distance + 9 * np.eye(len(group)) > 1e-3).all()
    return bool(np.allclose(group[0], np.eye(3), atol=1e-8) and is_apart and (off <= TOLERANCE).all())


def turned(R, axis, angle_rad):
    return R @ rotations_about(axis, [angle_rad])[0]


def reordered(group, rng):
    """The same elements in another order, the identity first."""
    return group[[0, *(1 + rng.permutation(len(group) - 1))]]


def generated(group, generators):
    """How many elements products of some elements reach, one product at a time."""
    reached = {0}
    while True:
        products = np.concatenate([group[list(reached)] @ group[generator] for generator in generators])
        nearest = np.linalg.norm(products[:, None] - group, axis=(2, 3)).argmin(axis=1)
        if set(nearest.tolist()) <= reached:
            return len(reached)
        reached |= set(nearest.tolist())


@pytest.mark.parametrize("name", GROUPS)
def test_every_kind_of_group_is_one_in_any_frame_and_order(name):
    rng = np.random.default_rng(0)
    for R in (np.eye(3), *uniform_rotations(3, rng)):
        group = reordered(R @ GROUPS[name] @ R.T, rng)
        assert check_group(group, TOLERANCE).faults == ()


@pytest.mark.parametrize("name", GROUPS)
def test_every_kind_of_group_is_one_after_rounding_to_float32_and_back_to_rotations(name):
    u, _, vt = np.linalg.svd(GROUPS[name].astype("f4").astype("f8"))  # u vt is the nearest rotation
    assert check_group(u @ vt, 2e-4).faults == ()


@pytest.mark.parametrize("name", SMALL)
def test_generators_generate_the_whole_group(name):
    check = check_group(GROUPS[name], TOLERANCE)
    if len(GROUPS[name]) > 1:
        assert generated(GROUPS[name], check.generators) == len(GROUPS[name])
        assert 2 ** len(check.generators) <= len(GROUPS[name])  # each of them at least doubles what is reached


@pytest.mark.parametrize("angle_rad", [1e-5, 1e-3, 0.1, 1.0])
@pytest.mark.parametrize("name", SEVERAL)
def test_group_of_which_one_element_is_turned_is_none(name, angle_rad):
    rng = np.random.default_rng(0)
    for element in rng.choice(np.arange(1, len(GROUPS[name])), 5):
        group = GROUPS[name].copy()
        group[element] = turned(group[element], rng.standard_normal(3), angle_rad)
        assert check_group(group, TOLERANCE).faults
        assert not by_all_products(group)


@pytest.mark.parametrize("name", SEVERAL)
def test_group_that_lacks_an_element_is_none(name):
    for element in range(1, len(GROUPS[name])):
        (fault,) = check_group(np.delete(GROUPS[name], element, axis=0), TOLERANCE).faults
        assert "is not in it, so it is no group" in fault


@pytest.mark.parametrize("off_rad", [0.0, 1e-9, 1e-7, 1e-6, 1e-4])
@pytest.mark.parametrize("name", GROUPS)
def test_group_that_has_an_element_twice_is_none_however_close(name, off_rad):
    """Close ones would pass for closed: turns by less than the tolerance and their products are all within it."""
    rng = np.random.default_rng(0)
    for element in rng.choice(len(GROUPS[name]), 3):
        again = turned(GROUPS[name][element], rng.standard_normal(3), off_rad)
        group = np.concatenate([GROUPS[name], again[None]])
        assert check_group(group, TOLERANCE).faults == (f"element {len(GROUPS[name])} is there twice",)


def test_group_doubled_by_a_turn_that_is_none_is_no_group():
    group = GROUPS["tetrahedral"]
    doubled = np.concatenate([group, turned(group, [0, 0, 1], 1e-8)])
    assert check_group(doubled, TOLERANCE).faults == ("element 12 is there twice",)


@pytest.mark.parametrize("name", SEVERAL)
def test_group_that_does_not_begin_with_the_identity_is_none(name):
    group = GROUPS[name].copy()
    group[[0, 1]] = group[[1, 0]]
    assert check_group(group, TOLERANCE).faults == ("element 0 is not the identity",)


@pytest.mark.parametrize("name", SMALL)
def test_group_with_one_element_more_is_none(name):
    foreign = uniform_rotations(1, np.random.default_rng(0))
    assert check_group(np.concatenate([GROUPS[name], foreign]), TOLERANCE).faults


@pytest.mark.parametrize("spoil", [np.nan, np.inf, -np.inf, 1e300, 1e-300, 0.0, -1.0])
@pytest.mark.parametrize("element", [0, 5, 11])
def test_element_that_is_no_rotation_is_named(spoil, element):
    group = GROUPS["tetrahedral"].copy()
    group[element] = spoil
    assert check_group(group, TOLERANCE).faults == (f"element {element} is no rotation",)


def test_union_of_two_subgroups_is_no_group():
    two, three = cyclic_group(2), cyclic_group(3)
    assert check_group(np.concatenate([two, three[1:]]), TOLERANCE).faults
    about_x = cyclic_group(2, axis=(1.0, 0.0, 0.0))
    assert check_group(np.concatenate([two, about_x[1:]]), TOLERANCE).faults


@settings(deadline=None)
@given(st.sampled_from(SEVERAL), st.data())
def test_part_of_a_group_is_one_where_all_its_products_are_in_it(name, data):
    chosen = data.draw(st.sets(st.integers(1, len(GROUPS[name]) - 1), max_size=12))
    part = GROUPS[name][[0, *sorted(chosen)]]
    assert (check_group(part, TOLERANCE).faults == ()) == by_all_products(part)


@settings(deadline=None)
@given(st.sampled_from(SEVERAL), st.data())
def test_what_some_elements_generate_is_a_group_and_a_part_of_it_is_not(name, data):
    group = GROUPS[name]
    first, second = (data.draw(st.integers(1, len(group) - 1)) for _ in range(2))
    reached = {0}
    while True:
        products = np.concatenate([group[list(reached)] @ group[element] for element in (first, second)])
        more = set(np.linalg.norm(products[:, None] - group, axis=(2, 3)).argmin(axis=1).tolist())
        if more <= reached:
            break
        reached |= more
    assert check_group(group[sorted(reached)], TOLERANCE).faults == ()
    assume(len(reached) > 2)
    left_out = data.draw(st.sampled_from(sorted(reached - {0})))
    assert check_group(group[sorted(reached - {left_out})], TOLERANCE).faults


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32), st.integers(1, 8))
def test_rotations_at_random_are_a_group_only_where_all_products_are_in_it(seed, count):
    rng = np.random.default_rng(seed)
    rotations = np.concatenate([np.eye(3)[None], uniform_rotations(count, rng)])
    assert (check_group(rotations, TOLERANCE).faults == ()) == by_all_products(rotations)


@pytest.mark.parametrize("name", SMALL)
def test_right_products_are_the_products_with_one_element(name):
    group = GROUPS[name]
    for element in range(len(group)):
        found = group[right_products(group, element)]
        np.testing.assert_allclose(found, [g @ group[element] for g in group], atol=1e-12)


def test_what_is_handed_in_stays_as_it_was_and_may_have_any_layout():
    group = np.asfortranarray(GROUPS["octahedral"])
    group.setflags(write=False)
    before = group.copy()
    first = check_group(group, TOLERANCE)
    assert first.faults == check_group(group[:, ::-1][:, ::-1], TOLERANCE).faults == ()
    np.testing.assert_array_equal(group, before)


@pytest.mark.parametrize(("group", "seconds"), [(cyclic_group(3600), 1.0), (dihedral_group(3600), 4.0)])
def test_largest_groups_take_seconds_at_most(group, seconds):
    before = time.process_time()
    assert check_group(group, TOLERANCE).faults == ()
    assert time.process_time() - before < seconds
