"""The losses of the reference models."""

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

__all__ = [
    "CONCENTRATION",
    "EPSILON",
    "classification_loss",
    "cyclic_cosine_loss",
    "evolving_winner_takes_all",
    "geodesic_loss",
    "relaxed_winner_takes_all",
    "von_mises_loss",
    "winner_takes_all",
    "winners_in_epoch",
]
