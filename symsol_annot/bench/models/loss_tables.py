"""The tables of losses, and the recipe keys that choose among them: a new loss is a function and an entry here."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal

from symsol_annot.bench.models.losses import (
    CONCENTRATION,
    EPSILON,
    classification_loss,
    cyclic_cosine_loss,
    evolving_winner_takes_all,
    geodesic_loss,
    relaxed_winner_takes_all,
    von_mises_loss,
    winner_takes_all,
    winners_in_epoch,
)
from symsol_annot.bench.models.recipe_keys import TrainingKeys, outside
from symsol_annot.bench.predictions.format import MAX_HYPOTHESES
from symsol_annot.system.text.tables import OneOf

if TYPE_CHECKING:
    from torch import Tensor

_MAX_CONCENTRATION = 1e6


@dataclass(frozen=True)
class LossArgument:
    """What a loss takes beside rotations or other losses; a recipe decides its value.

    Attributes:
        symbol: in pictures, as in the thesis.
        value_at: its value by a recipe, at an epoch on the recipe's scale.
        column: of an epoch's figures that tells the value; "" where it is the same in every epoch.
    """

    symbol: str
    value_at: Callable[[HypothesisLossKeys, float], float]
    column: str = ""


@dataclass(frozen=True)
class Loss:
    """All that is known of a loss.

    Attributes:
        name: in recipes.
        title: in pictures.
        equation: its number in the thesis.
        function: of tensors, and of `arguments` by their names.
        arguments: by their names.
        own_keys: recipe keys that are left out (None) with any other loss.
        least_hypotheses: M that it needs at least.
        faults: says what makes no sense in a recipe that names this loss.
    """

    name: str
    title: str
    equation: str
    function: Callable[..., Tensor]
    arguments: Mapping[str, LossArgument] = field(default_factory=dict)
    own_keys: tuple[str, ...] = ()
    least_hypotheses: int = 1
    faults: Callable[[HypothesisLossKeys], Iterator[str]] = lambda _: iter(())

    def arguments_at(self, keys: HypothesisLossKeys, epoch: float) -> dict[str, float]:
        """Return the arguments at an epoch."""
        return {name: argument.value_at(keys, epoch) for name, argument in self.arguments.items()}

    def figures_at(self, keys: HypothesisLossKeys, epoch: float) -> dict[str, float]:
        """Return the arguments that change during a training, by the names of their columns."""
        return {one.column: one.value_at(keys, epoch) for one in self.arguments.values() if one.column}

    def label(self, **arguments: float) -> str:
        """Return the title with the values of arguments, for a picture."""
        told = (f", {self.arguments[name].symbol} = {value:g}" for name, value in arguments.items())
        return self.title + "".join(told)


def winners_at(keys: HypothesisLossKeys, epoch: float) -> int:
    """Return k: halved at whole epochs, or smooth, M^(1 - epoch / epochs_to_one) rounded; 1 from `epochs_to_one` on."""
    if keys.epochs_to_one is None or epoch >= keys.epochs_to_one:
        return 1
    if keys.winners_schedule == "halved":
        return winners_in_epoch(int(epoch), keys.hypotheses, keys.epochs_to_one)
    return max(1, round(keys.hypotheses ** (1.0 - epoch / keys.epochs_to_one)))


def concentration_at(keys: HypothesisLossKeys, epoch: float) -> float:
    """Return K: from `concentration_at_first` to `concentration`, by the same factor in every epoch."""
    if keys.concentration_at_first is None or keys.epochs_to_concentration is None:
        return keys.concentration
    share = min(1.0, epoch / keys.epochs_to_concentration)
    return float(keys.concentration_at_first ** (1.0 - share) * keys.concentration**share)


def _epsilon_at(keys: HypothesisLossKeys, _: float) -> float:
    return keys.epsilon


def _faults_of_winners(keys: HypothesisLossKeys) -> Iterator[str]:
    if keys.epochs_to_one is None or not 0 <= keys.epochs_to_one < keys.epochs:
        yield (
            f"epochs_to_one: expected 0 to {keys.epochs - 1}, found {keys.epochs_to_one}: within {keys.epochs} "
            "epochs k would never be 1, and hypotheses only then go to single rotations"
        )


def _by_name(*losses: Loss) -> dict[str, Loss]:
    return {loss.name: loss for loss in losses}


META_LOSSES = _by_name(
    Loss("wta", "WTA", "4.15", winner_takes_all),
    Loss(
        "rwta",
        "RWTA",
        "4.16",
        relaxed_winner_takes_all,
        {"epsilon": LossArgument("epsilon", _epsilon_at)},
        least_hypotheses=2,
    ),
    Loss(
        "ewta",
        "EWTA",
        "4.17",
        evolving_winner_takes_all,
        {"k": LossArgument("k", winners_at, column="winners")},
        own_keys=("epochs_to_one",),
        faults=_faults_of_winners,
    ),
)
EMBEDDED_LOSSES = _by_name(
    Loss("cyclic-cosine", "cyclic cosine", "4.21", cyclic_cosine_loss),
    Loss(
        "von-mises",
        "von Mises",
        "4.22",
        von_mises_loss,
        {"concentration": LossArgument("K", concentration_at, column="concentration")},
        own_keys=("concentration_at_first",),
    ),
    Loss("geodesic", "geodesic", "4.20", geodesic_loss),
)
CLASSIFICATION = Loss("classification", "classification", "6.15", classification_loss)


@dataclass(frozen=True, kw_only=True)
class HypothesisLossKeys(TrainingKeys):
    """The recipe keys that decide the loss of M hypotheses per image (section 5.3).

    Attributes:
        hypotheses: M.
        meta_loss: over an image's hypotheses.
        embedded_loss: of one hypothesis.
        epsilon: of RWTA.
        winners_schedule: of EWTA's k, from M to 1: "halved" (section 5.3.1), or "smooth", evenly in its logarithm.
        epochs_to_one: after how many epochs k is 1; for EWTA alone.
        concentration: K of the von Mises loss.
        concentration_at_first: K in the beginning, where it is annealed (section 8.2); evenly in its logarithm.
        epochs_to_concentration: after how many epochs it is `concentration`.
    """

    hypotheses: int
    meta_loss: Annotated[str, OneOf(META_LOSSES)]
    embedded_loss: Annotated[str, OneOf(EMBEDDED_LOSSES)]
    epsilon: float = EPSILON
    winners_schedule: Literal["halved", "smooth"] = "halved"
    epochs_to_one: int | None = None
    concentration: float = CONCENTRATION
    concentration_at_first: float | None = None
    epochs_to_concentration: int | None = None

    def figures_at(self, epoch: float) -> dict[str, float]:
        """Return what changes in the losses, by the names of the columns."""
        losses = (META_LOSSES[self.meta_loss], EMBEDDED_LOSSES[self.embedded_loss])
        return {name: value for loss in losses for name, value in loss.figures_at(self, epoch).items()}

    def faults(self) -> Iterator[str]:
        """Say what makes no sense."""
        yield from super().faults()
        least = META_LOSSES[self.meta_loss].least_hypotheses
        yield from outside(self, hypotheses=(least, MAX_HYPOTHESES), epsilon=(0.0, 1.0))
        yield from self._faults_of(META_LOSSES, "meta loss", self.meta_loss)
        yield from self._faults_of_concentration()
        yield from self._faults_of(EMBEDDED_LOSSES, "embedded loss", self.embedded_loss)

    def _faults_of(self, table: Mapping[str, Loss], what: str, chosen: str) -> Iterator[str]:
        yield from table[chosen].faults(self)
        for loss in table.values():
            for key in loss.own_keys:
                if loss.name != chosen and getattr(self, key) is not None:
                    yield f"{key}: belongs to the {what} {loss.name}, found {chosen}"

    def _faults_of_concentration(self) -> Iterator[str]:
        annealed = (self.concentration_at_first, self.epochs_to_concentration)
        for name in ("concentration", "concentration_at_first"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value <= _MAX_CONCENTRATION:
                yield f"{name}: expected a number above 0, up to {_MAX_CONCENTRATION:,.0f}, found {value}"
        if (annealed[0] is None) != (annealed[1] is None):
            yield "concentration_at_first, epochs_to_concentration: expected both or neither"
        if annealed[1] is not None and not 0 < annealed[1] <= self.epochs:
            yield f"epochs_to_concentration: expected 1 to {self.epochs}, found {annealed[1]}"
