"""Each loss against its equation, by loops over numbers; gradients; and the numbers at which a naive formula fails."""

import itertools
import math
from functools import partial

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from symsol_annot.bench.models import losses
from symsol_annot.bench.models.batches import Batch
from symsol_annot.bench.models.loss_tables import EMBEDDED_LOSSES, META_LOSSES
from symsol_annot.bench.models.methods.hypotheses.method import HypothesisLearner
from symsol_annot.bench.models.methods.hypotheses.recipe import HypothesisRecipe
from symsol_annot.bench.models.networks.hypothesis_network import gram_schmidt
from symsol_annot.errors import SettingsError
from symsol_annot.rotations.so3 import rotations_about, uniform_rotations

torch.set_num_threads(1)
quick = settings(deadline=None, max_examples=100)


def rotations(count, seed):
    return uniform_rotations(count, np.random.default_rng(seed))


def numbers(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


# --- embedded losses ---


def cosine_by_hand(R_p, R_gt):
    """(Tr(R_p R_gt^T) - 1) / 2, one product after the other."""
    trace = 0.0
    for row in range(3):
        for inner in range(3):
            trace += float(R_p[row][inner]) * float(R_gt[row][inner])
    return (trace - 1) / 2


EMBEDDED = {  # the loss, and its equation of the cosine
    "cosine": (losses.cyclic_cosine_loss, lambda c: 1 - c),
    "von Mises": (losses.von_mises_loss, lambda c: 1 - math.exp(4 * (c - 1))),
    "von Mises 16": (partial(losses.von_mises_loss, concentration=16.0), lambda c: 1 - math.exp(16 * (c - 1))),
    "geodesic": (losses.geodesic_loss, math.acos),
}


@pytest.mark.parametrize("name", EMBEDDED)
def test_an_embedded_loss_is_its_equation(name):
    loss, equation = EMBEDDED[name]
    R_p, R_gt = rotations(20, seed=0), rotations(20, seed=1)
    expected = [equation(cosine_by_hand(a, b)) for a, b in zip(R_p, R_gt, strict=True)]
    np.testing.assert_allclose(loss(torch.from_numpy(R_p), torch.from_numpy(R_gt)), expected, rtol=1e-12)


@pytest.mark.parametrize("name", EMBEDDED)
def test_an_embedded_loss_depends_on_the_angle_alone_wherever_the_rotations_are(name):
    loss, equation = EMBEDDED[name]
    angles = np.array([1e-3, 0.5, 1.0, 2.0, 3.0, 3.13])
    anywhere = rotations(6, seed=2)
    turned = rotations_about((1.0, -2.0, 0.5), angles) @ anywhere
    found = loss(torch.from_numpy(turned), torch.from_numpy(anywhere))
    np.testing.assert_allclose(found, [equation(math.cos(a)) for a in angles], rtol=1e-8)


def test_hypotheses_are_compared_with_the_truth_of_their_own_image():
    R_p, R_gt = rotations(6, seed=0).reshape(2, 3, 3, 3), rotations(2, seed=1)
    found = losses.cyclic_cosine_loss(torch.from_numpy(R_p), torch.from_numpy(R_gt)[:, None])
    assert found.shape == (2, 3)
    for b, m in np.ndindex(2, 3):
        assert found[b, m] == pytest.approx(1 - cosine_by_hand(R_p[b, m], R_gt[b]), rel=1e-12)


@pytest.mark.parametrize("name", EMBEDDED)
def test_an_embedded_loss_is_0_at_the_truth_and_its_gradient_finite_there_and_half_a_turn_away(name):
    loss, _ = EMBEDDED[name]
    R_gt = torch.from_numpy(rotations(8, seed=3)).float()
    half_turned = torch.diag(torch.tensor([1.0, -1.0, -1.0])) @ R_gt
    for start in (R_gt, half_turned):
        vectors = start.mT[:, :2].clone().requires_grad_()
        values = loss(gram_schmidt(vectors), R_gt)
        values.sum().backward()
        assert vectors.grad.isfinite().all()
        assert values.isfinite().all()
        if start is R_gt:
            np.testing.assert_allclose(values.detach(), 0, atol=3e-6)
        else:
            largest = {"cosine": 2, "von Mises": 1 - math.exp(-8), "von Mises 16": 1, "geodesic": math.pi}[name]
            np.testing.assert_allclose(values.detach(), largest, atol=0.0029)


@pytest.mark.parametrize("name", EMBEDDED)
def test_gradients_of_an_embedded_loss_of_hypotheses(name):
    loss, _ = EMBEDDED[name]
    R_gt = torch.from_numpy(rotations(5, seed=4))
    vectors = torch.randn(5, 2, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0), requires_grad=True)
    assert torch.autograd.gradcheck(lambda v: loss(gram_schmidt(v), R_gt), vectors)


# --- meta losses ---


def wta_by_hand(row):
    return min(row)


def rwta_by_hand(row, epsilon):
    M = len(row)
    return (1 - epsilon * M / (M - 1)) * min(row) + epsilon / (M - 1) * sum(row)


def ewta_by_hand(row, k):
    """The least sum over all subsets of k hypotheses, as (4.17) is written."""
    return min(sum(subset) for subset in itertools.combinations(row, k))


def test_wta_is_the_least_loss():
    table = numbers(4, 30)
    np.testing.assert_allclose(losses.winner_takes_all(table), [wta_by_hand(row) for row in table.tolist()], rtol=0)


@pytest.mark.parametrize("M", [2, 3, 30])
@pytest.mark.parametrize("epsilon", [0.0, 0.05, 0.3, 1.0])
def test_rwta_is_its_equation(M, epsilon):
    table = numbers(4, M)
    expected = [rwta_by_hand(row, epsilon) for row in table.tolist()]
    np.testing.assert_allclose(losses.relaxed_winner_takes_all(table, epsilon), expected, rtol=1e-12)


def test_rwta_relaxes_by_5_percent_unless_told_otherwise():
    table = numbers(4, 7)
    assert torch.equal(losses.relaxed_winner_takes_all(table), losses.relaxed_winner_takes_all(table, 0.05))


def test_rwta_gives_the_winner_1_minus_epsilon_and_the_others_share_epsilon():
    row = torch.tensor([0.5, 0.2, 0.9, 0.4, 0.7], dtype=torch.float64, requires_grad=True)
    losses.relaxed_winner_takes_all(row, 0.2).backward()
    np.testing.assert_allclose(row.grad, [0.05, 0.8, 0.05, 0.05, 0.05], rtol=1e-12)


@pytest.mark.parametrize("k", [1, 2, 5, 8])
def test_ewta_is_the_least_sum_over_all_subsets_of_k(k):
    table = numbers(3, 8)
    expected = [ewta_by_hand(row, k) for row in table.tolist()]
    np.testing.assert_allclose(losses.evolving_winner_takes_all(table, k), expected, rtol=1e-12)


def test_ewta_pulls_its_k_winners_alike_and_nobody_else():
    row = torch.tensor([0.5, 0.2, 0.9, 0.4, 0.7], dtype=torch.float64, requires_grad=True)
    losses.evolving_winner_takes_all(row, 3).backward()
    assert row.grad.tolist() == [1, 1, 0, 1, 0]


def test_of_two_hypotheses_at_one_place_one_wins():
    row = torch.tensor([0.5, 0.2, 0.2], requires_grad=True)
    losses.winner_takes_all(row).backward()
    assert sorted(row.grad.tolist()) == [0, 0, 1]


META = {
    "WTA": losses.winner_takes_all,
    "RWTA": losses.relaxed_winner_takes_all,
    "EWTA": partial(losses.evolving_winner_takes_all, k=3),
}


@pytest.mark.parametrize("name", META)
def test_gradients_of_a_meta_loss_away_from_ties(name):
    assert torch.autograd.gradcheck(META[name], numbers(4, 6, seed=3).requires_grad_())


@pytest.mark.parametrize("name", META)
@pytest.mark.parametrize("embedded", EMBEDDED)
def test_every_pair_of_meta_and_embedded_loss_has_a_value_per_image(name, embedded):
    R_p, R_gt = torch.from_numpy(rotations(24, seed=0)).view(4, 6, 3, 3), torch.from_numpy(rotations(4, seed=1))
    table = EMBEDDED[embedded][0](R_p, R_gt[:, None])
    by_image = torch.stack([META[name](row) for row in table])
    assert by_image.shape == (4,)
    np.testing.assert_allclose(META[name](table), by_image, rtol=1e-12)
    np.testing.assert_allclose(META[name](table.flip(-1)), by_image, rtol=1e-12)  # whatever the hypotheses' order


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: losses.relaxed_winner_takes_all(numbers(4, 1)), "2 hypotheses or more for RWTA, found 1"),
        (lambda: losses.relaxed_winner_takes_all(numbers(4, 3), -0.01), r"in \[0, 1\] for RWTA, found -0.01"),
        (lambda: losses.relaxed_winner_takes_all(numbers(4, 3), 1.01), "found 1.01"),
        (lambda: losses.relaxed_winner_takes_all(numbers(4, 3), math.nan), "found nan"),
        (lambda: losses.evolving_winner_takes_all(numbers(4, 3), 0), "between 1 and 3 winners.*found 0"),
        (lambda: losses.evolving_winner_takes_all(numbers(4, 3), 4), "between 1 and 3 winners.*found 4"),
        (lambda: losses.winners_in_epoch(-1, 30, 20), "found -1, 30 and 20"),
        (lambda: losses.winners_in_epoch(0, 0, 20), "found 0, 0 and 20"),
        (lambda: losses.winners_in_epoch(0, 30, -20), "found 0, 30 and -20"),
    ],
)
def test_settings_that_make_no_sense_are_refused(call, said):
    with pytest.raises(SettingsError, match=said):
        call()


# --- the halving of k ---


def schedule(hypotheses, epochs_to_one, epochs):
    return [losses.winners_in_epoch(epoch, hypotheses, epochs_to_one) for epoch in range(epochs)]


def test_schedules_of_the_thesis():
    assert schedule(30, 20, 35) == [30] * 5 + [15] * 5 + [7] * 5 + [3] * 5 + [1] * 15
    assert schedule(30, 30, 50) == [30] * 8 + [15] * 7 + [7] * 8 + [3] * 7 + [1] * 20
    assert schedule(75, 20, 35) == [75] * 4 + [37] * 3 + [18] * 3 + [9] * 4 + [4] * 3 + [2] * 3 + [1] * 15


def test_schedules_at_the_edges():
    assert schedule(1, 5, 6) == [1] * 6
    assert schedule(30, 0, 2) == [1, 1]
    assert schedule(30, 2, 3) == [30, 7, 1]  # too few epochs for every half
    assert schedule(2, 3, 4) == [2, 2, 2, 1]


@quick
@given(st.integers(1, 200), st.integers(0, 60), st.integers(0, 10))
def test_a_schedule_begins_with_all_halves_evenly_and_ends_with_one(hypotheses, epochs_to_one, epochs_after):
    halves = [hypotheses]
    while halves[-1] > 1:
        halves.append(math.floor(halves[-1] / 2))
    found = schedule(hypotheses, epochs_to_one, epochs_to_one + 1 + epochs_after)
    assert found[epochs_to_one:] == [1] * (epochs_after + 1)
    above = found[:epochs_to_one]
    if hypotheses > 1 and epochs_to_one >= len(halves) - 1:
        assert list(dict.fromkeys(above)) == halves[:-1]
        lengths = [above.count(k) for k in halves[:-1]]
        assert max(lengths) - min(lengths) <= 1


# --- the classifier's loss ---


def classification_by_hand(logit_gt, negatives):
    """-log f(R) - the sum over K of log(1 - f(R_i)), with f as (6.5) is written."""
    f = [math.exp(x) / (math.exp(x) + 1) for x in (logit_gt, *negatives)]
    return -math.log(f[0]) + sum(-math.log(1 - p) for p in f[1:])


@pytest.mark.parametrize("K", [1, 2, 256])
def test_the_classifiers_loss_is_equation_6_15_summed_over_K(K):
    positive, negative = 6 * numbers(5, seed=1) - 3, 6 * numbers(5, K, seed=2) - 3
    expected = [classification_by_hand(p, n) for p, n in zip(positive.tolist(), negative.tolist(), strict=True)]
    found = losses.classification_loss(positive, negative)
    assert found.shape == (5,)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_the_classifiers_loss_of_no_negatives_is_of_the_truth_alone():
    assert float(losses.classification_loss(torch.zeros(()), torch.zeros(0))) == pytest.approx(math.log(2))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_classifiers_loss_is_finite_and_right_where_a_logarithm_of_0_would_not_be(dtype):
    for sure in (50.0, 1e3, 1e30):
        positive = torch.tensor([sure, -sure], dtype=dtype, requires_grad=True)
        negative = torch.tensor([[-sure], [sure]], dtype=dtype, requires_grad=True)
        found = losses.classification_loss(positive, negative)
        found.sum().backward()
        right, wrong = found.detach().double().tolist()
        assert right == pytest.approx(2 * math.exp(-sure), rel=1e-5)  # not rounded to 0 at 50
        assert wrong == pytest.approx(2 * sure, rel=1e-6)
        assert positive.grad.tolist() == pytest.approx([-math.exp(-sure), -1.0], rel=1e-5)
        assert negative.grad.flatten().tolist() == pytest.approx([math.exp(-sure), 1.0], rel=1e-5)


def test_gradients_of_the_classifiers_loss():
    inputs = (4 * numbers(3) - 2).requires_grad_(), (4 * numbers(3, 5, seed=1) - 2).requires_grad_()
    assert torch.autograd.gradcheck(losses.classification_loss, inputs)


# --- the tables ---

BY_NAME = {  # of recipes, with the keys that a recipe needs and what follows from them half way through
    "wta": (losses.winner_takes_all, {}),
    "rwta": (partial(losses.relaxed_winner_takes_all, epsilon=0.2), {"epsilon": 0.2}),
    "ewta": (partial(losses.evolving_winner_takes_all, k=2), {"epochs_to_one": 6, "winners_schedule": "halved"}),
    "cyclic-cosine": (losses.cyclic_cosine_loss, {}),
    "von-mises": (
        partial(losses.von_mises_loss, concentration=2.0),
        {"concentration_at_first": 1.0, "concentration": 4.0, "epochs_to_concentration": 8},
    ),
    "geodesic": (losses.geodesic_loss, {}),
}


class _Given(torch.nn.Module):
    """A network whose hypotheses are given."""

    def __init__(self, hypotheses):
        super().__init__()
        self._hypotheses, self.first_stage = hypotheses, lambda images: images.float()

    def from_embeddings(self, _):
        return self._hypotheses


@pytest.mark.parametrize("embedded", ["cyclic-cosine", "von-mises", "geodesic"])
@pytest.mark.parametrize("meta", ["wta", "rwta", "ewta"])
def test_a_recipe_trains_with_the_losses_that_it_names_at_their_values_of_the_moment(meta, embedded):
    """Half way through 8 epochs k is 2 of 4, and K the geometric mean of 1 and 4."""
    keys = {"title": "a", "epochs": 8, "batch_size": 2, "learning_rates": (1e-3,), "milestones": ()}
    (meta_loss, meta_keys), (embedded_loss, embedded_keys) = BY_NAME[meta], BY_NAME[embedded]
    made = HypothesisRecipe(
        **keys, hypotheses=4, meta_loss=meta, embedded_loss=embedded, **meta_keys, **embedded_keys, start="random"
    )
    assert list(made.faults()) == []
    hypotheses = torch.from_numpy(rotations(24, seed=0)).view(6, 4, 3, 3)
    batch = Batch(torch.zeros(6, 2, 2, 3, dtype=torch.uint8), torch.from_numpy(rotations(6, seed=1)))
    found = HypothesisLearner(made, _Given(hypotheses)).losses(batch, 4.0, torch.Generator())
    expected = meta_loss(embedded_loss(hypotheses, batch.R_gt[:, None]))
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=0)
    told = {"ewta": {"winners": 2}, "von-mises": {"concentration": 2.0}}
    assert made.figures_at(4.0) == pytest.approx({**told.get(meta, {}), **told.get(embedded, {})})


def test_the_tables_name_each_loss_once_with_its_equation():
    assert [*META_LOSSES, *EMBEDDED_LOSSES] == list(BY_NAME)
    for name, loss in {**META_LOSSES, **EMBEDDED_LOSSES}.items():
        assert loss.name == name
        assert f"(eq. {loss.equation})" in loss.function.__doc__
    assert EMBEDDED_LOSSES["von-mises"].label(concentration=4.0) == "von Mises, K = 4"
