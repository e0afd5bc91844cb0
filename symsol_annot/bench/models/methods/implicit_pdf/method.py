"""Implicit-PDF: how it is learnt, and how it is asked for densities (Murphy et al., ICML 2021)."""

import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from symsol_annot.bench.models.batches import Batch
from symsol_annot.bench.models.devices import training_precision
from symsol_annot.bench.models.methods.ahead import looking_ahead
from symsol_annot.bench.models.methods.classifier.negatives import random_rotations
from symsol_annot.bench.models.methods.implicit_pdf.recipe import ImplicitPdfRecipe
from symsol_annot.bench.models.methods.logits import LogitsByIndex
from symsol_annot.bench.models.methods.method import Asked
from symsol_annot.bench.models.networks.answers import RotationScorer, embeddings_of
from symsol_annot.bench.models.networks.backbones import BACKBONES
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier
from symsol_annot.bench.models.validation import Figures
from symsol_annot.bench.predictions.writing.listed import write_cells
from symsol_annot.rotations.grid import equivolumetric_grid
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Dataset
from symsol_annot.sets.shard.labels import Labels

_EVALUATED, _EVALUATION_LEVEL = 128, 3  # images, level of the grid: of a softmax that R_gt is added to
_EMBEDDED_AT_ONCE = 64  # images
_FLOOR = 1e-9  # of a cell's probability: a file of 5,000 images stays small


class ImplicitPdfLearner:
    """A density whose logarithm is a logit, up to what makes it one; from the rotations that images were drawn at."""

    def __init__(self, recipe: ImplicitPdfRecipe, model: RotationClassifier) -> None:
        self.recipe, self.model = recipe, model

    def losses(self, batch: Batch, epoch: float, rng: torch.Generator) -> Tensor:  # noqa: ARG002
        """Return -ln p(R_gt) (B,), relative to uniform: of the softmax over it and uniform rotations (eq. 5 there)."""
        others = random_rotations((len(batch.images), self.recipe.queries - 1), rng)
        queries = torch.cat([batch.R_gt[:, None], others], dim=1)
        with training_precision(batch.images, self.recipe.precision):
            logits = self.model.logits(self.model.first_stage(batch.images), queries)
        return torch.logsumexp(logits, dim=1) - math.log(self.recipe.queries) - logits[:, 0]

    @torch.no_grad()
    def evaluate(self, images: Tensor, labels: Labels) -> Figures:
        """Return the mean log-likelihood at R_gt of up to 128 of the images (N, H, W, 3), uint8.

        Of the softmax over R_gt and the grid of level 3, with SO(3)'s volume taken as pi^2, as papers have it.
        """
        grid, device = equivolumetric_grid(_EVALUATION_LEVEL), self.model.device
        shares = self.model.shares(torch.from_numpy(grid).float().to(device))
        scorer, found = RotationScorer(self.model), []
        for i, embedding in enumerate(embeddings_of(self.model, images[:_EVALUATED], _EMBEDDED_AT_ONCE)):
            R_gt = torch.from_numpy(labels.rotation[i : i + 1]).float().to(device)
            at_gt = scorer.logits(embedding, self.model.shares(R_gt))
            everywhere = torch.cat([scorer.logits(embedding, shares), at_gt])
            found.append(float(at_gt - torch.logsumexp(everywhere, 0)) + math.log(len(everywhere)))
        return {"log_likelihood_at_gt": float(np.mean(found)) - math.log(math.pi**2)}

    def calibrate(self, images: Tensor, labels: Labels) -> dict[str, float]:  # noqa: ARG002
        """Return nothing: a density is what it says."""
        return {}


class ImplicitPdfMethod:
    """How Implicit-PDFs are built, trained and asked."""

    def new_model(self, recipe: ImplicitPdfRecipe, pretrained: str | None, rng: torch.Generator) -> RotationClassifier:
        """Return a recipe's network, which is a classifier's: an embedding and a rotation to a logit."""
        backbone = BACKBONES[recipe.backbone]
        return RotationClassifier(
            recipe.frequencies, pretrained=pretrained, rng=rng, backbone=backbone, input_size=recipe.input_size
        )

    def learner(
        self,
        recipe: ImplicitPdfRecipe,
        model: RotationClassifier,
        symmetry_group: Rotations,  # noqa: ARG002 - it is told no symmetries
    ) -> ImplicitPdfLearner:
        """Return what trains a network by its recipe."""
        return ImplicitPdfLearner(recipe, model)

    def write_predictions(
        self, model: RotationClassifier, recipe: ImplicitPdfRecipe, dataset: Dataset, path: Path, asked: Asked
    ) -> None:
        """Write the densities of a split's images on the grid."""
        level = asked.level
        logits_of = LogitsByIndex(model, recipe.input_size, dataset, equivolumetric_grid(level), asked)
        by, resume = asked.method, asked.resume
        with looking_ahead(len(dataset)) as ahead:
            write_cells(
                path,
                dataset,
                lambda i: logits_of.on_grid(i).double().cpu().numpy(),
                method=by,
                floor=_FLOOR,
                level=level,
                resume=resume,
                around=ahead,
            )


METHOD = ImplicitPdfMethod()
