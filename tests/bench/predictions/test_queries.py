"""The queries: what is asked about an image follows from fingerprint and index, and hides the candidates."""

import hashlib
import itertools
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from query_oracle import recomputed
from scipy import stats
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from symsol_annot.bench.predictions.queries import DECOY_COSETS, Queries, group_sha256, query_count

FINGERPRINT = "5e" * 32
DIHEDRAL = Rotation.create_group("D360", axis="Z").as_matrix()
GROUPS = {
    "trivial": np.eye(3)[None],
    "tetrahedral": Rotation.create_group("T").as_matrix(),
    "octahedral": Rotation.create_group("O").as_matrix(),
    "a cylinder's 720": DIHEDRAL,
}
every_group = pytest.mark.parametrize("name", GROUPS)
TETRAHEDRAL = GROUPS["tetrahedral"]
R_GT = Rotation.random(random_state=1).as_matrix()
OTHER_R_GT = Rotation.random(random_state=2).as_matrix()


def assert_is_the_candidates_and_eight_whole_cosets(rotations, R_gt, group):
    """Take cosets out of the rotations, that of R_gt first, until none is left; each takes G of them, once each."""
    tree, is_left = cKDTree(rotations.reshape(-1, 9)), np.ones(len(rotations), dtype=bool)
    first = R_gt
    for _ in range(9):
        distance, index = tree.query((first @ group).reshape(-1, 9))
        assert distance.max() < 1e-9
        assert len(np.unique(index)) == len(group)
        assert is_left[index].all()
        is_left[index] = False
        first = rotations[np.argmax(is_left)]
    assert not is_left.any()


def places(queries, image_index):
    """Where (9, G) in the order of asking each number of the list is, if `unshuffle` is right."""
    return queries.unshuffle(image_index, np.arange(len(queries))).astype(int)


def decoys(images, fingerprint=FINGERPRINT):
    """The random R' (images, 8, 3, 3) behind a trivial group's queries."""
    queries = Queries(fingerprint, GROUPS["trivial"])
    return np.stack([queries.rotations(i, R_GT)[places(queries, i)[1:, 0]] for i in range(images)])


def uniform_angle_cdf(angle):
    """The distribution of the angle of a rotation that is uniform on SO(3)."""
    return (angle - np.sin(angle)) / np.pi


# --- what they follow from ---


@every_group
def test_queries_are_what_the_docstring_describes(name):
    group = GROUPS[name]
    for image_index in (0, 1, 4999) if len(group) < 100 else (3,):
        found = Queries(FINGERPRINT, group).rotations(image_index, R_GT)
        np.testing.assert_allclose(found, recomputed(FINGERPRINT, image_index, R_GT, group), rtol=0, atol=1e-14)


def test_queries_are_the_same_each_time_and_in_any_order_of_asking():
    forward, backward = Queries(FINGERPRINT, TETRAHEDRAL), Queries(str(FINGERPRINT), TETRAHEDRAL.copy())
    found = [forward.rotations(i, R_GT) for i in range(20)]
    for i in reversed(range(20)):
        np.testing.assert_array_equal(backward.rotations(i, R_GT), found[i])
        np.testing.assert_array_equal(backward.rotations(np.int64(i), R_GT), found[i])


def test_queries_of_one_image_do_not_follow_from_its_rotation_but_for_the_candidates():
    queries = Queries(FINGERPRINT, TETRAHEDRAL)
    is_candidate = np.isin(np.arange(len(queries)), places(queries, 5)[0])
    a, b = queries.rotations(5, R_GT), queries.rotations(5, OTHER_R_GT)
    np.testing.assert_array_equal(a[~is_candidate], b[~is_candidate])
    np.testing.assert_allclose(R_GT.T @ a[is_candidate], OTHER_R_GT.T @ b[is_candidate], atol=1e-14)


def test_another_fingerprint_or_index_gives_other_decoys_and_another_order():
    asked = [("a", 0), ("a", 1), ("a", 10), ("a", 11), ("b", 0), ("b", 1), ("a/1", 1), ("a/1", 0), (FINGERPRINT, 0)]
    cases = [(Queries(fingerprint, TETRAHEDRAL), index) for fingerprint, index in asked]
    for (one, i), (other, j) in itertools.combinations(cases, 2):
        ours, theirs = (q.rotations(k, R_GT)[places(q, k)[1:, 0]] for q, k in ((one, i), (other, j)))
        assert np.abs(ours[:, None] - theirs[None]).max(axis=(2, 3)).min() > 1e-3
        assert (places(one, i) != places(other, j)).mean() > 0.9


def test_decoys_do_not_follow_from_the_group():
    for group in GROUPS.values():
        queries = Queries(FINGERPRINT, group)
        identity = int(np.argmin(np.abs(group - np.eye(3)).max(axis=(1, 2))))
        found = queries.rotations(0, R_GT)[places(queries, 0)[1:, identity]]
        np.testing.assert_allclose(found, decoys(1)[0], atol=1e-14)


# --- what they hold ---


@every_group
def test_an_image_has_nine_times_as_many_queries_as_candidates(name):
    queries = Queries(FINGERPRINT, GROUPS[name])
    assert DECOY_COSETS == 8
    assert len(queries) == query_count(len(GROUPS[name])) == 9 * len(GROUPS[name])
    assert queries.rotations(0, R_GT).shape == (9 * len(GROUPS[name]), 3, 3)


@every_group
@pytest.mark.parametrize("image_index", [0, 77])
def test_queries_are_each_candidate_once_and_eight_whole_cosets(name, image_index):
    rotations = Queries(FINGERPRINT, GROUPS[name]).rotations(image_index, R_GT)
    assert_is_the_candidates_and_eight_whole_cosets(rotations, R_GT, GROUPS[name])


@every_group
def test_queries_are_rotations_and_all_different(name):
    rotations = Queries(FINGERPRINT, GROUPS[name]).rotations(3, R_GT)
    assert np.abs(np.einsum("nji,njk->nik", rotations, rotations) - np.eye(3)).max() < 1e-13
    np.testing.assert_allclose(np.linalg.det(rotations), 1, atol=1e-13)
    assert cKDTree(rotations.reshape(-1, 9)).query(rotations.reshape(-1, 9), k=2)[0][:, 1].min() > 1e-6


@pytest.mark.parametrize("name", ["tetrahedral", "octahedral", "a cylinder's 720"])
def test_group_multiplied_from_the_left_is_caught(name):
    group = GROUPS[name]
    swapped = recomputed(FINGERPRINT, 0, R_GT, group, compose=lambda R, g: g @ R)
    assert np.abs(Queries(FINGERPRINT, group).rotations(0, R_GT) - swapped).max() > 0.1
    with pytest.raises(AssertionError):
        assert_is_the_candidates_and_eight_whole_cosets(swapped, R_GT, group)


def test_decoys_alone_multiplied_from_the_left_are_caught():
    def swapped_but_for_candidates(R, g):
        return R @ g if R is R_GT else g @ R

    swapped = recomputed(FINGERPRINT, 0, R_GT, TETRAHEDRAL, compose=swapped_but_for_candidates)
    with pytest.raises(AssertionError):
        assert_is_the_candidates_and_eight_whole_cosets(swapped, R_GT, TETRAHEDRAL)


@pytest.mark.parametrize(
    "plant",
    [
        lambda rotations: np.concatenate([rotations[1:2], rotations[1:]]),
        lambda rotations: np.swapaxes(rotations, 1, 2),
        lambda rotations: rotations[:-1],
        lambda rotations: rotations @ np.diag([1.0, 1, -1]),
        lambda rotations: np.concatenate([rotations[:-1], R_GT[None]]),
    ],
    ids=["one twice", "transposed", "one short", "mirrored", "one of another coset"],
)
def test_list_that_is_not_whole_cosets_is_caught(plant):
    rotations = Queries(FINGERPRINT, TETRAHEDRAL).rotations(0, R_GT)
    planted = plant(rotations)
    with pytest.raises(AssertionError):
        assert_is_the_candidates_and_eight_whole_cosets(planted, R_GT, TETRAHEDRAL)


# --- their order ---


@every_group
def test_unshuffle_puts_candidates_in_row_0_and_decoys_in_the_others_in_the_order_of_the_group(name):
    group = GROUPS[name]
    queries = Queries(FINGERPRINT, group)
    place = places(queries, 12)
    assert place.shape == (9, len(group))
    np.testing.assert_array_equal(np.sort(place, axis=None), np.arange(len(queries)))
    in_order = queries.rotations(12, R_GT)[place]
    np.testing.assert_allclose(in_order[0], R_GT @ group, atol=1e-14)
    first = in_order[:, :1] @ group[0].T
    np.testing.assert_allclose(in_order, first @ group, atol=1e-13)
    np.testing.assert_allclose(first[1:, 0], decoys(13)[12], atol=1e-13)


@given(image_index=st.integers(0, 10**6), seed=st.integers(0, 100))
@settings(deadline=None, max_examples=40)
def test_shuffle_and_unshuffle_undo_each_other(image_index, seed):
    queries = Queries(FINGERPRINT, TETRAHEDRAL)
    probability = np.random.default_rng(seed).random(len(queries))
    np.testing.assert_array_equal(
        queries.shuffle(image_index, queries.unshuffle(image_index, probability)), probability
    )
    table = probability.reshape(9, 12)
    np.testing.assert_array_equal(queries.unshuffle(image_index, queries.shuffle(image_index, table)), table)


def test_unshuffle_keeps_probabilities_of_4_bytes_as_they_are():
    queries = Queries(FINGERPRINT, TETRAHEDRAL)
    probability = np.random.default_rng(0).random(len(queries)).astype(np.float32)
    np.testing.assert_array_equal(np.sort(queries.unshuffle(0, probability), axis=None), np.sort(probability))


def test_every_number_of_the_list_is_asked_at_every_place_equally_often():
    queries, images = Queries(FINGERPRINT, TETRAHEDRAL), 5000
    place = np.stack([places(queries, i).reshape(-1) for i in range(images)])
    expected = images / len(queries)
    table = np.zeros((108, 108))
    np.add.at(table, (np.arange(108)[None], place), 1)
    statistic = ((table - expected) ** 2 / expected).sum() * 107 / 108  # of a random permutation: 107^2 degrees
    assert 1e-3 < stats.chi2.sf(statistic, 107**2) < 1 - 1e-3
    for number in (0, 11, 12, 107):
        assert stats.chisquare(np.bincount(place[:, number], minlength=108)).pvalue > 1e-3


def test_candidates_stand_no_closer_together_than_chance():
    queries = Queries(FINGERPRINT, TETRAHEDRAL)
    gaps = [np.diff(np.sort(places(queries, i)[0])).min() for i in range(1000)]
    rng = np.random.default_rng(0)
    by_chance = [np.diff(np.sort(rng.choice(108, 12, replace=False))).min() for _ in range(1000)]
    assert abs(np.mean(gaps) - np.mean(by_chance)) < 4 * np.std(by_chance) * (2 / 1000) ** 0.5


# --- their decoys ---


def test_decoys_are_uniform_on_so3():
    R = decoys(2000).reshape(-1, 3, 3)
    angle = Rotation.from_matrix(R).magnitude()
    assert stats.kstest(angle, uniform_angle_cdf).pvalue > 1e-3
    assert (
        stats.kstest((Rotation.from_matrix(R_GT).inv() * Rotation.from_matrix(R)).magnitude(), uniform_angle_cdf)[1]
        > 1e-3
    )
    assert np.abs(R.mean(axis=0)).max() < 4 * (1 / 3 / len(R)) ** 0.5
    np.testing.assert_allclose((R**2).mean(axis=0), 1 / 3, atol=0.012)
    for i, j in np.ndindex(3, 3):  # each entry of a uniform rotation is uniform in [-1, 1]
        assert stats.kstest(R[:, i, j], stats.uniform(-1, 2).cdf).pvalue > 1e-3


def test_each_of_the_eight_decoys_is_uniform():
    R = decoys(2000)
    for number in range(8):
        assert stats.kstest(Rotation.from_matrix(R[:, number]).magnitude(), uniform_angle_cdf).pvalue > 1e-3


def test_decoys_of_an_image_and_of_neighbouring_images_are_independent():
    R = decoys(2000)
    pairs = [(R[:, 0], R[:, 1]), (R[:, 3], R[:, 7]), (R[:-1, 0], R[1:, 0]), (R[:-1, 7], R[1:, 0])]
    for a, b in pairs:
        between = (Rotation.from_matrix(a).inv() * Rotation.from_matrix(b)).magnitude()
        assert stats.kstest(between, uniform_angle_cdf).pvalue > 1e-3


def test_no_two_images_share_a_decoy():
    R = decoys(1000).reshape(-1, 9)
    assert cKDTree(R).query(R, k=2)[0][:, 1].min() > 1e-3


# --- the digest of a group ---


@every_group
def test_digest_of_a_group_is_of_its_entries_as_millionths_in_order(name):
    packed = b"".join(struct.pack("<i", round(entry * 2**20)) for entry in GROUPS[name].reshape(-1).tolist())
    assert group_sha256(GROUPS[name]) == hashlib.sha256(packed).hexdigest()


@every_group
def test_digest_of_a_group_survives_the_last_bits_of_another_c_library(name):
    rng = np.random.default_rng(0)
    for noise in (1e-15, 1e-12):
        noisy = GROUPS[name] + rng.choice([-noise, noise], size=GROUPS[name].shape)
        assert group_sha256(noisy) == group_sha256(GROUPS[name])


def test_digest_of_a_group_is_anothers_for_another_order_or_group():
    others = [*GROUPS.values(), TETRAHEDRAL[::-1], np.swapaxes(TETRAHEDRAL, 1, 2), DIHEDRAL[:360], DIHEDRAL[::2]]
    assert len({group_sha256(group) for group in others}) == len(others)
