"""How mixtures are learnt: negative log-likelihoods of members, and what is told beside them."""

import math
from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from symsol_annot.bench.models.batches import Batch
from symsol_annot.bench.models.devices import training_precision
from symsol_annot.bench.models.methods.mixture.body import body_for
from symsol_annot.bench.models.methods.mixture.calibration import fit
from symsol_annot.bench.models.methods.mixture.claims import Calibration
from symsol_annot.bench.models.methods.mixture.densities import Densities
from symsol_annot.bench.models.methods.mixture.image_density import ImageDensity
from symsol_annot.bench.models.methods.mixture.recipe import CIRCLE, FREE, GROUP, MixtureRecipe
from symsol_annot.bench.models.networks.answers import embeddings_of
from symsol_annot.bench.models.networks.mixture_network import MixtureNetwork, Told
from symsol_annot.bench.models.validation import Figures
from symsol_annot.rotations.grid import STANDARD_LEVEL, grid_size
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.shard.labels import Labels

_VIEWS_PER_IMAGE = 32  # candidates of an image that hides the marking, from which its views are learnt
_AT_ONCE, _EVALUATED = 256, 256  # images


class MixtureLearner:
    """A mixture density, from members of the annotated sets of its images.

    The losses of an image with the set S, and q the density that the network tells:

        free            -mean over S of ln q(R), over rotations drawn in it where it fills a volume, and the
                        cross-entropy of the class of |S|
        group           -ln of the mean over g of q(R_gt g)
        circle          -ln q(R_gt a), of the axis a
        marked-circle   that, -ln q(R_gt) where the marking shows, the cross-entropy of that it shows, and where it does
                        not, the cross-entropy of which candidates hide it, as seen from their viewing directions
    """

    def __init__(self, recipe: MixtureRecipe, model: MixtureNetwork, symmetry_group: Rotations) -> None:
        self.recipe, self.model = recipe, model
        self._body = body_for(recipe, symmetry_group, model.device)

    def losses(self, batch: Batch, epoch: float, rng: torch.Generator) -> Tensor:  # noqa: ARG002
        """Return the losses (B,)."""
        with training_precision(batch.images, self.recipe.precision):
            embeddings = self.model.first_stage(batch.images)
        told = self.model.told(embeddings.float(), is_directed=self._body.is_directed)
        if self.recipe.structure == FREE:
            return self._free(told, batch, rng)
        if self.recipe.structure == GROUP:
            return self._of_group(told, batch.R_gt)
        of_axis = -told.axis.log_density((batch.R_gt @ self._body.axis)[:, None])[:, 0]
        return (
            of_axis if self.recipe.structure == CIRCLE else of_axis + self._of_marking(told, *_with_members(batch), rng)
        )

    def _free(self, told: Told, batch: Batch, rng: torch.Generator) -> Tensor:
        group, (R_gt, is_member) = self._body.group, _with_members(batch)
        measure = is_member.sum(1).float()
        if len(group) > self.recipe.members:
            chosen = torch.multinomial(is_member.float(), self.recipe.members, replacement=True, generator=rng)
            R, shares = R_gt[:, None] @ group[chosen], torch.full(chosen.shape, 1.0 / self.recipe.members).to(R_gt)
        else:
            R, shares = R_gt[:, None] @ group, is_member / measure[:, None]
        if batch.volumes is not None and (has_volume := batch.volumes.index >= 0).any():
            of_volume = batch.volumes[has_volume]
            R[has_volume], shares[has_volume] = of_volume.draw(R.shape[1], rng), 1.0 / R.shape[1]
            measure[has_volume] += grid_size(STANDARD_LEVEL) * of_volume.measures()
        at_members = (told.pose.log_density(R) * shares).sum(1)
        of_size = functional.cross_entropy(told.set_size, self._body.set_size_class(measure), reduction="none")
        return self.recipe.marking_weight * of_size - at_members

    def _of_group(self, told: Told, R_gt: Tensor) -> Tensor:
        group = self._body.group
        return math.log(len(group)) - torch.logsumexp(told.pose.log_density(R_gt[:, None] @ group), dim=1)

    def _of_marking(self, told: Told, R_gt: Tensor, is_member: Tensor, rng: torch.Generator) -> Tensor:
        is_shown = (is_member.sum(1) <= self._body.few).float()
        of_pose = -told.pose.log_density(R_gt[:, None])[:, 0]
        of_shown = functional.binary_cross_entropy_with_logits(told.is_shown, is_shown, reduction="none")
        shape = (len(is_member), _VIEWS_PER_IMAGE)
        chosen = torch.randint(len(self._body.group), shape, generator=rng, device=rng.device)
        views = torch.einsum("bi,bvij->bvj", R_gt[:, 2], self._body.group[chosen])
        is_hidden = torch.gather(is_member, 1, chosen).float()
        of_views = functional.binary_cross_entropy_with_logits(self.model.hides(views), is_hidden, reduction="none")
        weight = self.recipe.marking_weight
        return is_shown * of_pose + weight * (of_shown + (1.0 - is_shown) * of_views.mean(1))

    @torch.no_grad()
    def evaluate(self, images: Tensor, labels: Labels) -> Figures:
        """Return the mean log-likelihood at R_gt of up to 256 of the images (N, H, W, 3), uint8.

        Of the density on SO(3) with its volume taken as pi^2, as papers have it, not averaged over the cells of a grid.
        """
        densities = self._densities(images[:_EVALUATED], Calibration())
        R_gt = torch.from_numpy(labels.rotation[:_EVALUATED]).float()
        log_p = [float(density.log_density(R[None])) for density, R in zip(densities, R_gt, strict=True)]
        return {"log_likelihood_at_gt": float(np.mean(log_p)) - math.log(math.pi**2)}

    @torch.no_grad()
    def calibrate(self, images: Tensor, labels: Labels) -> dict[str, float]:
        """Return what is fitted on validation images (N, H, W, 3), uint8, and the F-measure there with it."""
        told = self._told(images)

        def densities(calibration: Calibration) -> Iterator[ImageDensity]:
            return self._each(told, calibration)

        fitted, f = fit(self.recipe.structure, densities, labels, self._body.few)
        return {**fitted.to_record(), "f_measure": f}

    def _densities(self, images: Tensor, calibration: Calibration) -> Iterator[ImageDensity]:
        return self._each(self._told(images), calibration)

    def _told(self, images: Tensor) -> Told:
        embeddings = embeddings_of(self.model, images, _AT_ONCE)
        return self.model.told(embeddings, is_directed=self._body.is_directed).cpu()

    def _each(self, told: Told, calibration: Calibration) -> Iterator[ImageDensity]:
        densities = Densities(self.model, self.recipe.structure, self._body, calibration)
        for i in range(told.images):
            yield densities.of_image(told.row(i), i)


def _with_members(batch: Batch) -> tuple[Tensor, Tensor]:
    if batch.is_member is None:
        raise ValueError("a batch without members")
    return batch.R_gt, batch.is_member
