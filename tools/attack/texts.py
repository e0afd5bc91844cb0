"""Objects, recipes and scores: text of unknown origin, damaged."""

import copy
import json
from functools import partial

import numpy as np

from attack import laws
from attack.commands import outcome_of_command
from attack.damage import damage_json, damage_text, json_bytes
from attack.kinds import SCORING, Attempt, Kind

_LARGEST = 1e6


def _flipped(content, rng):
    """Return bytes with a few flipped bits, or cut short."""
    content = bytearray(content)
    if rng.random() < 0.3:
        return bytes(content[: rng.integers(len(content))])
    for at in rng.integers(0, 8 * len(content), rng.integers(1, 6)):
        content[at // 8] ^= 1 << int(at % 8)
    return bytes(content)


def _damaged(text, rng):
    """Return damaged text as bytes, and what was done."""
    if rng.random() < 0.2:
        return _flipped(text.encode(), rng), ["flipped bits, or cut"]
    text, done = damage_text(text, rng)
    return text.encode(errors="surrogatepass"), done


class Objects(Kind):
    """Folders of objects: object.toml and mesh.obj."""

    name, cases = "objects", 1000
    modules = ("objects.spec",)

    def __init__(self, root):
        from symsol_annot.objects.spec import builtin_names, load_object

        folders = [load_object(name).folder for name in builtin_names()]
        self._bases = [{path.name: path.read_text() for path in folder.glob("*.*")} for folder in folders]

    def attempt(self, place, number, rng):
        files = self._bases[rng.integers(len(self._bases))]
        damaged = str(rng.choice(["object.toml", "object.toml", "mesh.obj"]))
        content, done = _damaged(files[damaged], rng)
        for name, text in files.items():
            (place.case / name).write_bytes(content if name == damaged else text.encode())
        return Attempt([damaged, *done], lambda: self._load(place.case))

    @staticmethod
    def _load(folder):
        from symsol_annot.objects.spec import load_object

        spec = load_object(str(folder))
        if not spec.name.isascii() or "/" in spec.name or not spec.title.isprintable():
            raise laws.SilentError(f"a name or a title that is none: {spec.name!r}, {spec.title!r}")
        laws.check_group(spec.symmetry_group)
        laws.check_group(spec.stabiliser)
        if not np.isfinite(spec.mesh.vertices).all():
            raise laws.SilentError("mesh.obj: a vertex that is nowhere")
        return "right"


class Recipes(Kind):
    """Recipes of trainings."""

    name, cases = "recipes", 1000
    modules = ("bench.models.recipe", "cli")

    def __init__(self, root):
        from importlib import resources

        recipes = resources.files("symsol_annot.bench.models").joinpath("recipes")
        self._bases = [entry.read_text() for entry in recipes.iterdir() if entry.name.endswith(".toml")]

    def attempt(self, place, number, rng):
        path = place.case / "recipe.toml"
        content, done = _damaged(self._bases[rng.integers(len(self._bases))], rng)
        path.write_bytes(content)
        if rng.random() < 0.15:
            return Attempt(done, lambda: outcome_of_command("train", path, "--data", place.out))
        return Attempt(done, lambda: self._load(path))

    @staticmethod
    def _load(path):
        from symsol_annot.bench.models.recipe import load_recipe, recipe_from_toml, recipe_to_toml

        file = load_recipe(str(path))
        for name, has_marking in (("tetX", True), ("cylO", True), ("tet", False)):
            recipe = file.for_object(name, has_marking=has_marking)
            if recipe_from_toml(recipe_to_toml(recipe), "again") != recipe:
                raise laws.SilentError("a recipe that is another one when it is written and read again")
            if not 0 < recipe.epochs < _LARGEST or not all(0 < rate < np.inf for rate in recipe.learning_rates):
                raise laws.SilentError(f"numbers that no training has: {recipe}")
        return "right"


def make_scores(folder):
    """Make two methods' scores, and a leaderboard with one of them."""
    from bench_sets import small_set

    from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses
    from symsol_annot.bench.scoring.reports import report
    from symsol_annot.bench.scoring.scoring import score_file

    dataset = small_set(folder, "tetX", 8)
    labels = dataset.labels()
    for name, shift in (("first", 0.0), ("second", 0.1)):
        path = folder / f"{name}.h5"
        write_hypotheses(path, dataset, labels.rotation[:, None], method=name)
        write_classifier(path, dataset, partial(_claims, 0.5 + shift), method=name, level=0)
        write_density(path, dataset, partial(_density, 3.0 + shift), method=name, level=0)
        document = report.to_document([score_file(path, dataset.folder)])
        (folder / f"{name}.json").write_text(report.to_json(document))
    _make_board(folder)


def _claims(above, _, R):
    return R[:, 0, 0] > above


def _density(slope, _, R):
    return slope * R[:, 1, 1]


def _make_board(folder):
    scores = json.loads((folder / "first.json").read_text())
    entry = scores["objects"]["tetX"]
    board = folder / "board" / "small"
    board.mkdir(parents=True)
    (board / "first.json").write_bytes((folder / "first.json").read_bytes())
    (board / "first.toml").write_text(
        'title = "First"\nby = "A"\ndate = 2026-01-31\nhardware = "a CPU"\ncommands = ["make"]\ncode = ""\n'
        'notes = "none"\n[objects.tetX]\nseed = 0\nminutes = 1.5\n'
    )
    (board / "set.toml").write_text(
        f'title = "Small"\nsplit = "{entry["split"]}"\nimages = {entry["images"]}\ncommands = ["make"]\n'
        f'[fingerprints]\ntetX = "{entry["fingerprint"]}"\n'
    )
    (folder / "board" / "thesis.toml").write_text('notes = "none"\n[tables]\n[small]\n')


class Scores(Kind):
    """scores.json files, compared, drawn, and on a leaderboard."""

    name, cases = "scores", 1000
    modules, bases = SCORING, ("scores",)

    def __init__(self, root):
        folder = root / "scores"
        self._bases = [json.loads((folder / f"{name}.json").read_text()) for name in ("first", "second")]

    def attempt(self, place, number, rng):
        documents = copy.deepcopy(self._bases)
        paths = [place.case / "first.json", place.case / "second.json"]
        done = damage_json(documents[0], rng)
        contents = [json_bytes(document) for document in documents]
        if rng.random() < 0.15:
            contents[0], done = _flipped(contents[0], rng), ["flipped bits, or cut"]
        for path, content in zip(paths, contents, strict=True):
            path.write_bytes(content)
        return Attempt(done, self._action(paths, place, rng))

    @staticmethod
    def _action(paths, place, rng):
        kind = rng.random()
        if kind < 0.3:
            return lambda: outcome_of_command("compare", *paths)
        if kind < 0.85:
            return lambda: _compare(paths)
        which = "precision-recall" if kind < 0.95 else "coverage"
        drawn = place.out / "drawn.svg"
        return lambda: outcome_of_command("plot", which, *paths, "--object", "tetX", "--out", drawn)


def _compare(paths):
    from symsol_annot.bench.scoring.reports.comparison import compare

    tables = compare(paths)
    if not all(line.isprintable() for line in tables.split("\n")):
        raise laws.SilentError("tables with what a terminal would obey")
    return "right"


class Leaderboards(Kind):
    """A leaderboard's folder: results as TOML beside their scores."""

    name, cases = "leaderboards", 300
    modules, bases = (*SCORING, "bench.leaderboard.page"), ("scores",)

    def __init__(self, root):
        board = root / "scores" / "board"
        self._files = {str(path.relative_to(board)): path.read_text() for path in board.rglob("*.*")}

    def attempt(self, place, number, rng):
        names = sorted(self._files)
        damaged = names[rng.integers(len(names))]
        content, done = _damaged(self._files[damaged], rng)
        for name, text in self._files.items():
            path = place.case / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content if name == damaged else text.encode())
        page = place.out / "page.md"
        return Attempt([damaged, *done], lambda: outcome_of_command("leaderboard", place.case, "--out", page))
