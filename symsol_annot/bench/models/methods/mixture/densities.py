"""Which density a model tells of an image, by the structure of its recipe."""

from functools import cached_property

import torch

from symsol_annot.bench.models.methods.mixture.body import Body
from symsol_annot.bench.models.methods.mixture.circle_densities import CircleDensity, MarkedCircleDensity
from symsol_annot.bench.models.methods.mixture.claims import Calibration
from symsol_annot.bench.models.methods.mixture.image_density import ImageDensity, PoseDensity
from symsol_annot.bench.models.methods.mixture.marking_views import MarkingViews
from symsol_annot.bench.models.methods.mixture.recipe import CIRCLE, GROUP, MARKED_CIRCLE
from symsol_annot.bench.models.networks.mixture_network import MixtureNetwork, Told


class Densities:
    """The densities that a model, as its weights are now, tells of images; worked out on the CPU, one by one.

    Args:
        model: that tells of them.
        structure: the recipe's.
        body: the object's.
        calibration: fitted on validation images.
    """

    def __init__(self, model: MixtureNetwork, structure: str, body: Body, calibration: Calibration) -> None:
        self._model, self._structure, self._body, self._calibration = model, structure, body.cpu(), calibration

    @cached_property
    def _views(self) -> MarkingViews:
        return MarkingViews(self._model, self._body)

    def of_image(self, told: Told, seed: int) -> ImageDensity:
        """Return the density of one image.

        Args:
            told: of this image alone.
            seed: of the samples by which the threshold is found.
        """
        rng = torch.Generator().manual_seed(seed)
        body, calibration = self._body, self._calibration
        if self._structure == MARKED_CIRCLE:
            return MarkedCircleDensity(told, self._views, body, calibration, rng)
        if self._structure == CIRCLE:
            return CircleDensity(told.axis, body, calibration, rng)
        if self._structure == GROUP:
            return PoseDensity(told.pose.spread_over(body.group), len(body.group), calibration, rng)
        members = float(body.set_sizes[int(told.set_size[0].argmax())])
        return PoseDensity(told.pose, members, calibration, rng, has_volume=members > len(body.group))
