"""Recipes: all that decides how a model is trained, as TOML; one a row of the thesis's tables is built in.

docs/training.md lists the keys. A recipe's tables [marked] and [objects.NAME] replace keys for objects with a marking
and for single objects; `RecipeFile.for_object` gives what is left for one object, and that goes into a checkpoint.
"""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Literal, TypeAlias

from symsol_annot.bench.predictions.format import MAX_GRID_LEVEL, MAX_HYPOTHESES
from symsol_annot.errors import SettingsError, bulleted, count_of
from symsol_annot.system.reading import read_text
from symsol_annot.system.text.names import METHOD_NAME_RULE, OBJECT_NAME_RULE, is_method_name, is_object_name
from symsol_annot.system.text.tables import from_table
from symsol_annot.system.text.toml import MAX_TOML_BYTES, TITLE_RULE, is_title, parse_toml, shown

MetaLoss = Literal["wta", "rwta", "ewta"]
EmbeddedLoss = Literal["cyclic-cosine", "von-mises", "geodesic"]
WinnersSchedule = Literal["halved", "smooth"]
BackboneStart = Literal["imagenet", "random"]
FirstStageStart = Literal["imagenet", "random", "best-recall", "best-precision"]

_MARKED, _OBJECTS = "marked", "objects"
MAX_EPOCHS = 10_000  # a checkpoint's header holds the figures of each
_MAX_BATCH_SIZE, _MAX_NEGATIVES, _MAX_FREQUENCIES = 2**16, 2**20, 16
_MAX_RATES, _MAX_OBJECTS, _MAX_KEYS = 64, 256, 64
_MAX_VALIDATION_IMAGES, _MAX_CONCENTRATION = 10_000_000, 1e6


@dataclass(frozen=True, kw_only=True)
class _Training:
    """What both models' recipes have.

    Attributes:
        title: the row of the thesis's tables, in words.
        epochs: how many.
        batch_size: images per step; an epoch's last images, if fewer, are left out of it.
        learning_rates: Adam's learning rates, one after another.
        milestones: after how many epochs each but the first begins.
        validation_images: how many images, the last of the train split, are evaluated after each epoch, not learnt.
    """

    title: str
    epochs: int
    batch_size: int
    learning_rates: tuple[float, ...]
    milestones: tuple[int, ...]
    validation_images: int = 500

    def faults(self) -> Iterator[str]:
        """Say what makes no sense."""
        if not is_title(self.title):
            yield f"title: expected {TITLE_RULE}, found {shown(self.title)}"
        yield from _outside(
            self,
            epochs=(1, MAX_EPOCHS),
            batch_size=(2, _MAX_BATCH_SIZE),
            validation_images=(0, _MAX_VALIDATION_IMAGES),
        )
        if len(self.learning_rates) > _MAX_RATES:
            yield f"learning_rates: expected at most {_MAX_RATES}, found {len(self.learning_rates)}"
        if len(self.learning_rates) != len(self.milestones) + 1:
            drops, rates = len(self.milestones), len(self.learning_rates)
            yield f"learning_rates: expected one more than milestones, which are {drops}, found {rates}"
        if not all(0.0 < rate < math.inf for rate in self.learning_rates):
            yield f"learning_rates: expected numbers above 0, found {shown(list(self.learning_rates))}"
        if sorted(set(self.milestones)) != list(self.milestones):
            yield f"milestones: expected ascending epochs, found {shown(list(self.milestones))}"
        if any(not 0 < epoch < self.epochs for epoch in self.milestones):
            yield f"milestones: expected epochs from 1 to {self.epochs - 1}, found {shown(list(self.milestones))}"


@dataclass(frozen=True, kw_only=True)
class HypothesisRecipe(_Training):
    """How a HypothesisNetwork is trained (section 5.3).

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
        start: of the backbone.
    """

    hypotheses: int
    meta_loss: MetaLoss
    embedded_loss: EmbeddedLoss
    epsilon: float = 0.05
    winners_schedule: WinnersSchedule = "halved"
    epochs_to_one: int | None = None
    concentration: float = 4.0
    concentration_at_first: float | None = None
    epochs_to_concentration: int | None = None
    start: BackboneStart = "imagenet"

    def faults(self) -> Iterator[str]:
        """Say what makes no sense."""
        yield from super().faults()
        least = 2 if self.meta_loss == "rwta" else 1
        yield from _outside(self, hypotheses=(least, MAX_HYPOTHESES), epsilon=(0.0, 1.0))
        yield from self._faults_of_winners()
        yield from self._faults_of_concentration()

    def _faults_of_winners(self) -> Iterator[str]:
        if self.meta_loss == "ewta":
            if self.epochs_to_one is None or not 0 <= self.epochs_to_one < self.epochs:
                yield (
                    f"epochs_to_one: expected 0 to {self.epochs - 1}, found {self.epochs_to_one}: within {self.epochs} "
                    "epochs k would never be 1, and hypotheses only then go to single rotations"
                )
        elif self.epochs_to_one is not None:
            yield f"epochs_to_one: belongs to the meta loss ewta, found {self.meta_loss}"

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
        if annealed[0] is not None and self.embedded_loss != "von-mises":
            yield f"concentration_at_first: belongs to the embedded loss von-mises, found {self.embedded_loss}"


@dataclass(frozen=True, kw_only=True)
class ClassifierRecipe(_Training):
    """How a RotationClassifier is trained (section 7.3).

    Attributes:
        negatives: K, wrong rotations an image and step.
        hard_negatives: how many of them are rejected candidates of the image, not random rotations; not in the thesis.
        frequencies: F of the positional encoding; 0 for none.
        frozen_epochs: for how many epochs the first stage stays as it began.
        start: of the first stage: that of the hypothesis network with the lowest error in recall or in precision, or
            a backbone alone.
        evaluation_level: of the grid on which the validation images are asked.
    """

    negatives: int
    hard_negatives: int = 0
    frequencies: int = 3
    frozen_epochs: int = 4
    start: FirstStageStart = "best-recall"
    evaluation_level: int = 4

    def faults(self) -> Iterator[str]:
        """Say what makes no sense."""
        yield from super().faults()
        yield from _outside(
            self,
            negatives=(1, _MAX_NEGATIVES),
            hard_negatives=(0, self.negatives),
            frequencies=(0, _MAX_FREQUENCIES),
            frozen_epochs=(0, self.epochs - 1),
            evaluation_level=(0, MAX_GRID_LEVEL),
        )


Recipe: TypeAlias = HypothesisRecipe | ClassifierRecipe
_MODELS: dict[str, type[Recipe]] = {"hypotheses": HypothesisRecipe, "classifier": ClassifierRecipe}


@dataclass(frozen=True)
class RecipeFile:
    """A recipe as written: keys for all objects, and what replaces them for some.

    Attributes:
        name: of the file, without its suffix; also what the method is called, unless it is told otherwise.
        base, marked, objects: tables of keys.
    """

    name: str
    base: Mapping[str, Any]
    marked: Mapping[str, Any]
    objects: Mapping[str, Mapping[str, Any]]

    @property
    def title(self) -> str:
        """The row of the thesis's tables, in words."""
        return str(self.base["title"])

    def for_object(self, name: str, *, has_marking: bool) -> Recipe:
        """Return the recipe for an object: its own keys before those of marked objects before the others."""
        table = {**self.base, **(self.marked if has_marking else {}), **self.objects.get(name, {})}
        recipe, faults = _recipe_of(table)
        if recipe is None or faults:
            raise _refusal(self.name, [f"for {name}: {fault}" for fault in faults])
        return recipe


def builtin_recipes() -> list[str]:
    """Return the names of the built-in recipes."""
    folder = resources.files("symsol_annot.bench.models").joinpath("recipes")
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def load_recipe(name_or_path: str) -> RecipeFile:
    """Return a built-in recipe by its name, or one from a file.

    Raises:
        SettingsError: there is none, or it has faults; the message lists all.
    """
    if name_or_path in builtin_recipes():
        source = resources.files("symsol_annot.bench.models").joinpath("recipes", f"{name_or_path}.toml")
        return parse_recipe(source.read_text(encoding="utf-8"), name_or_path)
    path = Path(name_or_path)
    try:
        text = read_text(path, MAX_TOML_BYTES)
    except FileNotFoundError:
        raise SettingsError(
            f"{path}: there is no such file, and no built-in recipe of that name; built in are "
            f"{', '.join(builtin_recipes())}"
        ) from None
    except (OSError, ValueError) as error:  # no UTF-8, or no path
        reason = getattr(error, "strerror", None) or error
        raise SettingsError(f"{path}: the recipe cannot be read: {reason}") from None
    if not is_method_name(_name_of(path)):
        raise SettingsError(f"{path}: expected a file whose name, less .toml, is {METHOD_NAME_RULE}; rename it")
    return parse_recipe(text, str(path))


def parse_recipe(text: str, source: str) -> RecipeFile:
    """Return the recipe that TOML text holds.

    Raises:
        SettingsError: it is no TOML, or has faults for some object; the message lists all.
    """
    try:
        table = parse_toml(text)
    except ValueError as error:
        raise SettingsError(f"{source}: is no TOML: {error}") from None
    marked, objects = table.pop(_MARKED, {}), table.pop(_OBJECTS, {})
    strange = list(_strange_groups(table, marked, objects))
    if strange:
        raise _refusal(source, strange)
    faults = _recipe_of(table)[1]
    faults += [fault for fault in _faults_of_replaced(table, marked, objects) if fault.partition(": ")[2] not in faults]
    if faults:
        raise _refusal(source, faults)
    return RecipeFile(_name_of(Path(source)), table, marked, objects)


def recipe_to_toml(recipe: Recipe) -> str:
    """Return a recipe for one object as TOML with all its keys."""
    model = next(name for name, kind in _MODELS.items() if isinstance(recipe, kind))
    known = {"model": model, **asdict(recipe)}
    return "".join(
        f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in known.items() if value is not None
    )


def recipe_from_toml(text: str, source: str) -> Recipe:
    """Undo `recipe_to_toml`.

    Raises:
        SettingsError: as `parse_recipe`.
    """
    return parse_recipe(text, source).for_object("", has_marking=False)


def _name_of(path: Path) -> str:
    return path.name.removesuffix(".toml")


def _strange_groups(base: Mapping[str, Any], marked: Any, objects: Any) -> Iterator[str]:
    """Say what of the tables of keys is no table, of no object, or larger than a recipe has use for."""
    if not isinstance(objects, dict):
        yield f"{_OBJECTS}: expected a table of keys, found {shown(objects)}"
        objects = {}
    if len(objects) > _MAX_OBJECTS:
        yield f"{_OBJECTS}: expected at most {_MAX_OBJECTS}, found {len(objects)}"
        objects = {}
    for name in objects:
        if not is_object_name(name):
            yield f"{_OBJECTS}: expected an object's name, {OBJECT_NAME_RULE}, found {shown(name)}"
    groups = {"the recipe": base, _MARKED: marked, **{f"{_OBJECTS}.{name}": keys for name, keys in objects.items()}}
    for name, keys in groups.items():
        if not isinstance(keys, dict):
            yield f"{name}: expected a table of keys, found {shown(keys)}"
        elif len(keys) > _MAX_KEYS:
            yield f"{name}: expected at most {_MAX_KEYS} keys, found {len(keys)}"


def _faults_of_replaced(
    base: Mapping[str, Any], marked: Mapping[str, Any], objects: Mapping[str, Mapping[str, Any]]
) -> Iterator[str]:
    if marked:
        yield from (f"[{_MARKED}]: {fault}" for fault in _recipe_of({**base, **marked})[1])
    for name, keys in objects.items():
        both = [_recipe_of({**base, **common, **keys})[1] for common in ({}, marked)]
        if all(both):  # whether it has a marking is not known here
            yield from (f"[{_OBJECTS}.{name}]: {fault}" for fault in both[0])


def _recipe_of(table: Mapping[str, Any]) -> tuple[Recipe | None, list[str]]:
    """Return the recipe that keys make, or None; and their faults."""
    keys = dict(table)
    model = keys.pop("model", None)
    if not isinstance(model, str) or model not in _MODELS:
        return None, [f"model: expected {' or '.join(_MODELS)}, found {shown(model)}"]
    recipe, faults = from_table(_MODELS[model], keys, f"a {model} recipe")
    return recipe, faults or list(recipe.faults() if recipe else ())


def _outside(recipe: Any, **ranges: tuple[float, float]) -> Iterator[str]:
    for name, (least, most) in ranges.items():
        value = getattr(recipe, name)
        if not least <= value <= most:
            yield f"{name}: expected {least} to {most}, found {value}"


def _refusal(source: str, faults: list[str]) -> SettingsError:
    return SettingsError(
        f"{source}: the recipe has {count_of(faults)}; docs/training.md lists the keys:\n" + bulleted(faults)
    )
