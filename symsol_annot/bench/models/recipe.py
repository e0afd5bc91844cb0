"""Files of recipes, in TOML: one per row of the thesis's tables is built in.

docs/training.md lists the keys. A recipe's tables [marked] and [objects.NAME] replace keys for objects with a marking
and for single objects; `RecipeFile.for_object` gives what is left for one object, and that goes into a checkpoint.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from importlib import resources
from pathlib import Path
from typing import Any

from symsol_annot.bench.models.kinds import MODEL_KINDS, Recipe, kind_of
from symsol_annot.bench.models.recipe_keys import LEFT_OUT
from symsol_annot.errors import SettingsError, bulleted, count_of
from symsol_annot.system.reading import read_text
from symsol_annot.system.text.names import METHOD_NAME_RULE, OBJECT_NAME_RULE, is_method_name, is_object_name, nearest
from symsol_annot.system.text.tables import from_table
from symsol_annot.system.text.toml import MAX_TOML_BYTES, parse_toml, shown

_MARKED, _OBJECTS = "marked", "objects"
_MAX_OBJECTS, _MAX_KEYS = 256, 64


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
            f"{', '.join(builtin_recipes())}{nearest(name_or_path, builtin_recipes())}"
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
    """Return a recipe for one object as TOML with all its keys, but for those that have no value."""
    keys = {"model": kind_of(recipe).name}
    for key in fields(recipe):
        value = getattr(recipe, key.name)
        if value is not None and not (key.metadata.get(LEFT_OUT) and value == key.default):
            keys[key.name] = value
    return "".join(f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in keys.items())


def recipe_from_toml(text: str, source: str) -> Recipe:
    """Return the recipe that `recipe_to_toml` wrote.

    Args:
        text: TOML.
        source: where it comes from, for error messages.

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
    if not isinstance(model, str) or model not in MODEL_KINDS:
        return None, [f"model: expected {' or '.join(MODEL_KINDS)}, found {shown(model)}"]
    recipe, faults = from_table(MODEL_KINDS[model].recipe, keys, f"a {model} recipe")
    return recipe, faults or list(recipe.faults() if recipe else ())


def _refusal(source: str, faults: list[str]) -> SettingsError:
    return SettingsError(
        f"{source}: the recipe has {count_of(faults)}; docs/training.md lists the keys:\n" + bulleted(faults)
    )
