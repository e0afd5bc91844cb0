"""The kinds of models, in one table: a new method is a room in `methods`, with a recipe's class, and an entry here."""

from dataclasses import dataclass
from importlib import import_module
from typing import TypeAlias

from symsol_annot.bench.models.methods.classifier.recipe import ClassifierRecipe
from symsol_annot.bench.models.methods.diffusion.recipe import DiffusionRecipe
from symsol_annot.bench.models.methods.hypotheses.recipe import HypothesisRecipe
from symsol_annot.bench.models.methods.implicit_pdf.recipe import ImplicitPdfRecipe
from symsol_annot.bench.models.methods.method import Method
from symsol_annot.bench.models.methods.mixture.recipe import MixtureRecipe

Recipe: TypeAlias = HypothesisRecipe | ClassifierRecipe | MixtureRecipe | ImplicitPdfRecipe | DiffusionRecipe


@dataclass(frozen=True)
class ModelKind:
    """All that is known of a kind of model.

    Attributes:
        name: the value of a recipe's key `model`.
        title: in messages.
        recipe: its class, whose fields are the recipe's keys.
        tracks: of its predictions.
        best_by: the metric by which the best epoch is chosen.
        module: has METHOD; by its name, as recipes are read without torch.
        scores_rotations: whether rotations go through a network when it is asked, which is what takes the time.
        chooses_hypotheses: whether it may be asked for hypotheses that leave less out, or for its surest one.
    """

    name: str
    title: str
    recipe: type[Recipe]
    tracks: tuple[str, ...]
    best_by: str
    module: str
    scores_rotations: bool = False
    chooses_hypotheses: bool = False

    @property
    def method(self) -> Method:
        """How its models are built, trained and asked; imports torch."""
        method: Method = import_module(self.module).METHOD
        return method


_METHODS = "symsol_annot.bench.models.methods"
MODEL_KINDS = {
    kind.name: kind
    for kind in (
        ModelKind(
            name="hypotheses",
            title="hypothesis network",
            recipe=HypothesisRecipe,
            tracks=("hypotheses",),
            best_by="recall_mean_error_rad",
            module=f"{_METHODS}.hypotheses.method",
        ),
        ModelKind(
            name="classifier",
            title="classifier",
            recipe=ClassifierRecipe,
            tracks=("classifier",),
            best_by="f_measure",
            module=f"{_METHODS}.classifier.method",
            scores_rotations=True,
        ),
        ModelKind(
            name="mixture",
            title="mixture density",
            recipe=MixtureRecipe,
            tracks=("hypotheses", "classifier", "density"),
            best_by="log_likelihood_at_gt",
            module=f"{_METHODS}.mixture.method",
            chooses_hypotheses=True,
        ),
        ModelKind(
            name="implicit-pdf",
            title="Implicit-PDF",
            recipe=ImplicitPdfRecipe,
            tracks=("density",),
            best_by="log_likelihood_at_gt",
            module=f"{_METHODS}.implicit_pdf.method",
            scores_rotations=True,
        ),
        ModelKind(
            name="diffusion",
            title="diffusion",
            recipe=DiffusionRecipe,
            tracks=("hypotheses", "density"),
            best_by="recall_mean_error_rad",
            module=f"{_METHODS}.diffusion.method",
            scores_rotations=True,
        ),
    )
}


def kind_of(recipe: Recipe) -> ModelKind:
    """Return the kind of model that a recipe is of."""
    return next(kind for kind in MODEL_KINDS.values() if isinstance(recipe, kind.recipe))
