"""What changes while a model is trained: the learning rate, EWTA's k, the von Mises loss's K, what is frozen.

An epoch is a number on the recipe's own scale, with a fraction within it: 0.5 is half way through the first. Training
for more or fewer epochs than a recipe has stretches or shrinks all of it alike.
"""

from bisect import bisect_right
from dataclasses import dataclass

from symsol_annot.bench.models.networks.losses import winners_in_epoch
from symsol_annot.bench.models.recipe import HypothesisRecipe, Recipe


@dataclass(frozen=True)
class ScheduledValues:
    """What holds at one moment of a training.

    Attributes:
        learning_rate: of Adam.
        winners: k of EWTA; of another meta loss 1.
        concentration: K of the von Mises loss.
        is_frozen: whether the first stage is.
    """

    learning_rate: float
    winners: int = 1
    concentration: float = 0.0
    is_frozen: bool = False


def scheduled_values_at(recipe: Recipe, epoch: float) -> ScheduledValues:
    """Return what holds at an epoch from 0 to the recipe's last."""
    rate = recipe.learning_rates[bisect_right(recipe.milestones, epoch)]
    if isinstance(recipe, HypothesisRecipe):
        return ScheduledValues(rate, winners_at(recipe, epoch), concentration_at(recipe, epoch))
    return ScheduledValues(rate, is_frozen=epoch < recipe.frozen_epochs)


def winners_at(recipe: HypothesisRecipe, epoch: float) -> int:
    """Return k: halved at whole epochs, or smooth, M^(1 - epoch / epochs_to_one) rounded; 1 from `epochs_to_one` on."""
    if recipe.epochs_to_one is None or epoch >= recipe.epochs_to_one:
        return 1
    if recipe.winners_schedule == "halved":
        return winners_in_epoch(int(epoch), recipe.hypotheses, recipe.epochs_to_one)
    return max(1, round(recipe.hypotheses ** (1.0 - epoch / recipe.epochs_to_one)))


def concentration_at(recipe: HypothesisRecipe, epoch: float) -> float:
    """Return K: from `concentration_at_first` to `concentration`, by the same factor in every epoch."""
    if recipe.concentration_at_first is None or recipe.epochs_to_concentration is None:
        return recipe.concentration
    share = min(1.0, epoch / recipe.epochs_to_concentration)
    return float(recipe.concentration_at_first ** (1.0 - share) * recipe.concentration**share)
