"""A symmetry set can be asked about rotations, and used like the array of its members."""

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from symsol_annot.annotation.symmetry_set import SymmetrySet, circles_of
from symsol_annot.annotation.volume import CELLS, Volume
from symsol_annot.errors import RotationError, SettingsError
from symsol_annot.objects.spec import load_object
from symsol_annot.rotations.so3 import rotations_about, uniform_rotations

GROUPS = {name: load_object(name).symmetry_group for name in ("tet", "icosa", "cyl")}


def make_set(name="tet", seed=0, share=0.5, volume=None):
    rng = np.random.default_rng(seed)
    group = GROUPS[name]
    mask = rng.random(len(group)) < share
    mask[0] = True
    return SymmetrySet(uniform_rotations(1, rng)[0], group, mask, volume)


def test_members_are_R_gt_times_the_chosen_symmetries_and_R_gt_is_the_first():
    found = make_set()
    expected = [found.R_gt @ g for g, chosen in zip(GROUPS["tet"], found.is_member, strict=True) if chosen]
    np.testing.assert_allclose(found.members, expected, atol=1e-15)
    np.testing.assert_array_equal(found.members[0], found.R_gt)
    np.testing.assert_array_equal(found.candidates[found.is_member], found.members)
    assert found.measure == len(expected)


@pytest.mark.parametrize("name", GROUPS)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_distance_is_the_angle_to_the_nearest_member(name, seed):
    found = make_set(name, seed)
    R = uniform_rotations(5, np.random.default_rng(seed))
    expected = [Rotation.from_matrix(one.T @ found.members).magnitude().min() for one in R]
    np.testing.assert_allclose(found.distance(R), expected, atol=1e-7)  # what arccosine loses is in the oracle


@pytest.mark.parametrize("name", GROUPS)
def test_a_set_contains_its_members_and_what_is_within_the_tolerance_of_them(name):
    found = make_set(name)
    turn = rotations_about((0.6, 0.0, 0.8), [0.0, 0.9e-3, 1.1e-3])
    near = found.members[0] @ turn
    assert found.contains(found.members).all()
    assert found.contains(near).tolist() == [True, False, False]
    assert found.contains(near, tolerance_rad=1e-3).tolist() == [True, True, False]
    assert found.contains(near, tolerance_rad=found.distance(near).max()).all()  # the tolerance itself is within it
    rejected = found.candidates[~found.is_member]
    assert len(rejected)
    assert not found.contains(rejected).any()


@pytest.mark.parametrize("volume", [None, "cap"])
@pytest.mark.parametrize("name", GROUPS)
def test_of_no_rotations_there_are_no_distances(name, volume):
    found, none = make_set(name, volume=CAP if volume else None), np.zeros((0, 3, 3))
    for asked in (found.contains, found.distance, found.distance_to_arcs):
        assert asked(none).shape == (0,)


def test_an_arc_is_as_far_as_its_members_or_nearer():
    group = GROUPS["cyl"]
    mask = np.zeros(len(group), dtype=bool)
    mask[:20] = True  # steps of 1 degree about the z axis
    found = SymmetrySet(np.eye(3), group, mask)
    between = rotations_about((0, 0, 1), np.radians([-0.25, 4.5, 19.25]))
    np.testing.assert_allclose(np.degrees(found.distance(between)), [0.25, 0.5, 0.25])
    np.testing.assert_allclose(np.degrees(found.distance_to_arcs(between)), [0.25, 0.0, 0.25], atol=1e-6)
    isolated = make_set("tet")
    R = uniform_rotations(7, np.random.default_rng(0))
    np.testing.assert_array_equal(isolated.distance_to_arcs(R), isolated.distance(R))


@pytest.mark.parametrize(
    ("steps", "in_order"),
    [
        ([0, 1, 5, 350, 359], [350, 359, 0, 1, 5]),  # about the z axis, in degrees
        ([0, 1, 3], [0, 1, 3]),
        ([0, 100, 110, 355], [355, 0, 100, 110]),
    ],
)
def test_members_along_arcs_go_round_each_circle_from_where_its_longest_gap_ends(steps, in_order):
    group = GROUPS["cyl"]
    mask = np.zeros(len(group), dtype=bool)
    mask[[*steps, 360, 540]] = True
    found = SymmetrySet(uniform_rotations(1, np.random.default_rng(0))[0], group, mask)
    np.testing.assert_allclose(found.along_arcs[: len(steps)], found.R_gt @ group[in_order], atol=1e-15)
    assert sorted(map(tuple, found.along_arcs.reshape(-1, 9))) == sorted(map(tuple, found.members.reshape(-1, 9)))


def test_members_of_isolated_rotations_along_arcs_are_in_the_groups_order():
    isolated = make_set("icosa")
    np.testing.assert_array_equal(isolated.along_arcs, isolated.members)


def test_circles_are_those_of_the_group_alone():
    assert circles_of(GROUPS["tet"]) is None
    assert circles_of(GROUPS["cyl"]).index.shape == (2, 360)


def test_samples_are_members_each_as_likely_and_follow_the_seed():
    found = make_set("tet", share=0.4)
    drawn = found.sample(6000, np.random.default_rng(0))
    counts = (np.abs(drawn[:, None] - found.members).max(axis=(2, 3)) == 0).sum(axis=0)
    assert counts.sum() == 6000
    assert np.abs(counts - 6000 / len(found)).max() < 5 * np.sqrt(6000 / len(found))
    np.testing.assert_array_equal(found.sample(9, np.random.default_rng(3)), found.sample(9, np.random.default_rng(3)))
    assert found.sample(0, np.random.default_rng(0)).shape == (0, 3, 3)
    with pytest.raises(SettingsError, match="found -1"):
        found.sample(-1, np.random.default_rng(0))


@pytest.mark.parametrize(
    "arguments",
    [
        (np.eye(3)[None], GROUPS["tet"], np.ones(12, dtype=bool)),
        (np.eye(3), GROUPS["tet"], np.ones(11, dtype=bool)),
        (np.eye(3), GROUPS["tet"], np.arange(12) > 0),
    ],
    ids=["R_gt of two dimensions", "short mask", "without R_gt"],
)
def test_what_is_no_set_is_refused(arguments):
    with pytest.raises(RotationError, match="symmetry set: "):
        SymmetrySet(*arguments)


# As an array


USES = {
    "asarray": np.asarray,
    "float32": lambda S: np.asarray(S, dtype=np.float32),
    "shape": lambda S: (S.shape, S.ndim, S.size, len(S), S.dtype),
    "first": lambda S: S[0],
    "slice": lambda S: S[1:, :, 2],
    "mask": lambda S: S[np.arange(len(S)) % 2 == 0],
    "iteration": list,
    "left product": lambda S: rotations_about((0, 0, 1), 0.3) @ S,
    "right product": lambda S: S @ rotations_about((0, 0, 1), 0.3),
    "product of two": lambda S: S @ S,
    "points": lambda S: np.arange(6.0).reshape(2, 3) @ S,
    "difference": lambda S: np.abs(S - np.eye(3)).max(axis=(1, 2)),
    "scalar": lambda S: 2.0 * S + 1,
    "comparison": lambda S: S[0] < S,
    "mean": np.mean,
    "sum": lambda S: np.sum(S, axis=0),
    "stack": lambda S: np.stack([S, S]),
    "concatenate": lambda S: np.concatenate([S, S[:1]]),
    "einsum": lambda S: np.einsum("nij,kj->nik", S, np.eye(3)),
    "transpose": lambda S: np.swapaxes(S, 1, 2),
    "norm": lambda S: np.linalg.norm(S, axis=(1, 2)),
    "methods": lambda S: (S.mean(), S.reshape(-1, 9), S.T, S.astype("f4"), S.tolist(), S.tobytes(), S.copy()),
    "scipy": lambda S: Rotation.from_matrix(S).as_rotvec(),
}


@pytest.mark.parametrize("use", USES.values(), ids=USES)
def test_a_set_can_be_used_like_the_array_of_its_members(use):
    found = make_set()
    np.testing.assert_equal(use(found), use(found.members))


def test_a_copy_of_the_array_is_a_copy():
    found = make_set()
    np.array(found)[:] = 0
    assert found.members.any()


def test_torch_takes_a_set_at_once():
    torch = pytest.importorskip("torch")
    found = make_set()
    for tensor in (torch.as_tensor(found), torch.as_tensor(np.asarray(found)), torch.from_numpy(found.members)):
        assert tensor.dtype == torch.float64
        np.testing.assert_array_equal(tensor.numpy(), found.members)


def test_a_set_survives_pickling_and_copying():
    found = make_set("cyl")
    for other in (pickle.loads(pickle.dumps(found)), copy.deepcopy(found), copy.copy(found)):
        np.testing.assert_array_equal(other.members, found.members)


def test_a_set_says_how_many_rotations_or_cells_it_has():
    assert repr(make_set(share=0.0)) == "<SymmetrySet: 1 rotations>"
    assert repr(make_set(volume=Volume(np.arange(CELLS) < CELLS / 4))) == "<SymmetrySet: 25.00% of all rotations>"


def test_a_misspelt_name_is_an_error():
    with pytest.raises(AttributeError, match="'SymmetrySet' object has no attribute 'membres'"):
        _ = make_set().membres


# With a volume


CAP = Volume.of_directions(lambda v: v[:, 0] > 0.8)  # a tenth of all directions


def test_with_a_volume_a_set_is_no_array_and_says_what_to_do():
    found = make_set(volume=CAP)
    for use in (len, np.asarray, list, lambda S: S @ np.eye(3), lambda S: S[0], lambda S: S.shape, lambda S: S.mean()):
        with pytest.raises(RotationError, match=r"`\.sample\(n, rng\)`"):
            use(found)
    assert len(found.members)


def test_a_set_with_a_volume_contains_that_and_its_members():
    found = make_set(share=0.3, volume=CAP)
    drawn = found.sample(400, np.random.default_rng(0))
    assert CAP.contains(drawn).all()
    assert found.contains(drawn).all()
    assert found.distance(drawn).max() == 0
    assert found.measure == CAP.measure
    everywhere = uniform_rotations(4000, np.random.default_rng(1))
    np.testing.assert_array_equal(found.contains(everywhere), CAP.contains(everywhere))
    assert found.contains(found.members).all()


def test_distance_with_a_volume_is_to_what_is_nearer_a_member_or_the_volume():
    found, isolated = make_set(volume=CAP), make_set()
    R = uniform_rotations(500, np.random.default_rng(1))
    to_members, to_volume = isolated.distance(R), CAP.distance(R)
    assert (to_members < to_volume).any()
    assert (to_members > to_volume).any()
    np.testing.assert_array_equal(found.distance(R), np.minimum(to_members, to_volume))
    np.testing.assert_array_equal(found.distance_to_arcs(R), found.distance(R))
