"""Where an epoch of a training lies on its recipe's scale, which is stretched to the epochs, extended ones too."""

from symsol_annot.bench.models.training.record import TrainingRecord


def rate_position(record: TrainingRecord, epoch: float) -> float:
    """Return where the learning rate stands: the recipe's schedule, stretched to the number of epochs.

    An extension stretches it anew, so that the rate rises where the training goes on, and ends as the recipe's does.

    Args:
        record: of the training.
        epoch: from 0, with a fraction within it; not before the last extension.
    """
    return epoch * record.recipe.epochs / record.epochs


def stage_position(record: TrainingRecord, epoch: float) -> float:
    """Return where all else stands that changes in a training: what is frozen, how many winners, the concentration.

    An extension does not lead back: what was reached before it stays reached until the stretched schedule is there too.

    Args:
        record: of the training.
        epoch: from 0, with a fraction within it; not before the last extension.
    """
    reached = (done * record.recipe.epochs / planned for done, planned in record.extensions)
    return max((rate_position(record, epoch), *reached))
