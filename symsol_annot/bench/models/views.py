"""Several views of one object: which rotations fit all of them, the intersection of their symmetry sets (eq. 6.2)."""

import torch
from torch import Tensor

from symsol_annot.bench.models.networks.answers import embeddings_of, probabilities
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier
from symsol_annot.bench.predictions.format import STANDARD_THRESHOLD
from symsol_annot.errors import RotationError


def probability_in_all_views(classifier: RotationClassifier, images: Tensor, R_w2c: Tensor, R_m2w: Tensor) -> Tensor:
    """Return the least of the views' probabilities f(I_v, R_w2c_v R_m2w): a rotation is in all sets if it is in each.

    Args:
        classifier: of the object.
        images: (V, H, W, 3) uint8, of the object where it stands.
        R_w2c: (V, 3, 3), from a common frame to each view's camera.
        R_m2w: (Q, 3, 3), from the object to the common frame: what is asked about.

    Returns:
        (Q,) probabilities.

    Raises:
        RotationError: rotations of another shape.
    """
    if R_w2c.shape != (len(images), 3, 3) or R_m2w.shape[1:] != (3, 3):
        raise RotationError(
            f"expected a camera's rotation for each of {len(images)} views, ({len(images)}, 3, 3), and rotations "
            f"(Q, 3, 3), found {tuple(R_w2c.shape)} and {tuple(R_m2w.shape)}"
        )
    embeddings = embeddings_of(classifier, images, len(images))
    R_m2w, R_w2c = R_m2w.to(embeddings), R_w2c.to(embeddings)
    views = [probabilities(classifier, e, R @ R_m2w) for e, R in zip(embeddings, R_w2c, strict=True)]
    return torch.stack(views).amin(dim=0)


def in_all_views(
    classifier: RotationClassifier,
    images: Tensor,
    R_w2c: Tensor,
    R_m2w: Tensor,
    threshold: float = STANDARD_THRESHOLD,
) -> Tensor:
    """Return which rotations are in the symmetry set of every view (eq. 6.2), at a threshold (eq. 7.4).

    Args:
        classifier: of the object.
        images: (V, H, W, 3) uint8, of the object where it stands.
        R_w2c: (V, 3, 3), from a common frame to each view's camera.
        R_m2w: (Q, 3, 3), from the object to the common frame: what is asked about.
        threshold: that a probability has to exceed in every view.

    Returns:
        (Q,) bool.

    Raises:
        RotationError: rotations of another shape.
    """
    return probability_in_all_views(classifier, images, R_w2c, R_m2w) > threshold
