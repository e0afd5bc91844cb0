"""The rows of the leaderboard that this repository makes: their names, places and commands, and what they are told."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from symsol_annot.bench.leaderboard.results import SET, THESIS
from symsol_annot.bench.models.kinds import MODEL_KINDS, kind_of
from symsol_annot.bench.models.methods.method import BALANCED, COVERING, SUREST
from symsol_annot.bench.models.recipe import load_recipe
from symsol_annot.bench.models.retrieval import retrieval
from symsol_annot.bench.models.training.checkpoints import WEIGHTS_FILE
from symsol_annot.bench.scoring.metric import LEAST_DECIMALS
from symsol_annot.errors import SymsolError
from symsol_annot.objects.spec import load_object
from symsol_annot.system.reading import file_sha256

BOARD = Path(__file__).resolve().parent / "results" / "leaderboard"
TIERS = {"small": "small", "published": "data"}  # to the folders of their sets, as the commands of its set.toml have it
MARKED = ("tetX", "cylO")
TITLES = {BALANCED: "", COVERING: "180 hypotheses: ", SUREST: "Surest hypothesis: "}
COMPILED = ("classifier", "implicit-pdf")  # models that torch.compile makes faster
ONE_OBJECT = {  # rows of one object alone
    "mixture-64": "cylO",
    **dict.fromkeys(("small-classifier-hard-negatives", "small-classifier-f5", "small-classifier-longer"), "tetX"),
    **dict.fromkeys(("volume-classifier", "volume-classifier-outside", "volume-classifier-unweighted"), "sphereX"),
}


class BaselineError(SymsolError):
    """A step cannot be done."""


@dataclass(frozen=True)
class Row:
    """A recipe that was or will be trained with one seed, on the objects of a tier.

    Attributes:
        recipe: its name.
        tier: "small" or "published", a folder of the leaderboard.
        seed: of the training.
        folder: that the commands are run in.
        hypotheses: which of a mixture's it lists; all but "balanced" are rows beside that of the recipe, of the same
            trainings.
    """

    recipe: str
    tier: str
    seed: int
    folder: Path
    hypotheses: str = BALANCED

    is_trained: ClassVar[bool] = True

    @property
    def method(self) -> str:
        """What results share that differ in their seed alone."""
        return self.recipe if self.hypotheses == BALANCED else f"{self.recipe}-{self.hypotheses}"

    @property
    def name(self) -> str:
        """Of the result's files."""
        return f"{self.method}-seed-{self.seed}" if self.seed else self.method

    def run(self, name: str) -> str:
        """Return the folder of an object's training, from the working folder."""
        seed = f"-seed-{self.seed}" if self.seed else ""
        return f"runs/{name}-{self.recipe}{seed}"

    @property
    def data(self) -> str:
        """The folder of the sets, from the working folder."""
        return TIERS[self.tier]

    @property
    def place(self) -> Path:
        """Of the result's files."""
        return BOARD / self.tier

    @property
    def scores(self) -> Path:
        """The file of the scores, in the working folder."""
        return self.folder / f"{self.name}.json.gz"

    def weights(self, name: str) -> Path:
        """Return the checkpoint of an object."""
        return self.folder / self.run(name) / WEIGHTS_FILE

    def predictions(self, name: str) -> Path:
        """Return the predictions about an object."""
        return self.folder / f"{name}-{self.name}.h5"

    def note(self, step: str) -> Path:
        """Return what is kept of a finished step: "OBJECT-predict", or "score"."""
        return self.folder / "done" / f"{self.name}-{step}.json"

    def fingerprints(self) -> Mapping[str, str]:
        """Return the objects of the tier, and the fingerprints of their test splits."""
        found: Mapping[str, str] = tomllib.loads((self.place / SET).read_text())["fingerprints"]
        return found

    def objects(self) -> list[str]:
        """Return the objects that the recipe is trained on: of the published tier all, but of the thesis's two."""
        there = list(self.fingerprints())
        of_thesis = {name for t in tomllib.loads((BOARD / THESIS).read_text())["tables"].values() for name in t["rows"]}
        is_thesiss = self.recipe in of_thesis or self.recipe.startswith("reduced-")
        if self.tier == "published" and (is_thesiss or self.hypotheses != BALANCED):
            there = list(MARKED)
        return [name for name in there if name == ONE_OBJECT.get(self.recipe, name)]

    def predicted(self) -> list[str]:
        """Return the objects that have predictions."""
        return [name for name in self.fingerprints() if self.predictions(name).is_file()]

    def train_command(self, name: str) -> list[str]:
        """Return the words that train the recipe on an object."""
        seeded = ["--seed", str(self.seed), "--out", self.run(name)] if self.seed else []
        return ["symsol-annot", "train", self.recipe, "--data", self.data, "--object", name, *seeded]

    def predict_command(self, name: str) -> list[str]:
        """Return the words that predict an object's test images."""
        kind = kind_of(load_recipe(self.recipe).for_object(name, has_marking=False))
        asked = ["--precision", "auto"] if kind.scores_rotations and self.tier == "published" else []
        asked += ["--compile"] if asked and kind.name in COMPILED else []
        asked += ["--hypotheses", self.hypotheses] if self.hypotheses != BALANCED else []
        out = self.predictions(name).name
        return ["symsol-annot", "predict", self.run(name), "--data", self.data, "--out", out, *asked]

    def score_command(self, names: list[str]) -> list[str]:
        """Return the words that score the predictions."""
        files, small = [f"{name}-{self.name}.h5" for name in names], ["--decimals", str(LEAST_DECIMALS)]
        return ["symsol-annot", "score", *files, "--data", self.data, "--json", self.scores.name, *small]

    @property
    def title(self) -> str:
        """In words."""
        return TITLES[self.hypotheses] + load_recipe(self.recipe).title.partition(", small")[0]

    def made_from(self, name: str) -> str:
        """Return a digest of what predictions about an object are made from: its checkpoint's."""
        return file_sha256(self.weights(name))

    def knowledge(self) -> dict[str, bool]:
        """Return what the recipe is told of any object, whatever object it is scored on, so that seeds agree."""
        file, objects = load_recipe(self.recipe), self.objects()
        found = [file.for_object(name, has_marking=load_object(name).marking is not None) for name in objects]
        has_structure = any(getattr(recipe, "structure", "free") != "free" for recipe in found)
        return {
            "given_group": has_structure or any(recipe.needs_rejected_candidates for recipe in found),
            "given_sets": any(
                recipe.needs_members or recipe.needs_rejected_candidates or recipe.needs_volumes for recipe in found
            ),
        }


@dataclass(frozen=True)
class Retrieval(Row):
    """The nearest train images: a row that no training stands behind."""

    is_trained: ClassVar[bool] = False

    @property
    def title(self) -> str:
        """In words."""
        return f"Nearest train images, {retrieval.DEFAULT_SIZE} pixels, no training"

    def objects(self) -> list[str]:
        """Return all objects of the tier."""
        return list(self.fingerprints())

    def predict_command(self, name: str) -> list[str]:
        """Return the words that predict an object's test images."""
        return ["symsol-annot", "retrieve", f"{self.data}/{name}", "--out", f"{name}-{self.name}.h5"]

    def made_from(self, name: str) -> str:
        """Return a digest of what predictions about an object are made from: the fingerprint of its test split."""
        return self.fingerprints()[name]

    def knowledge(self) -> dict[str, bool]:
        """Return what it is told: symmetry sets of train images, on which the threshold of its claims is fitted."""
        return {"given_group": False, "given_sets": True}


def row_of(recipe: str, tier: str, seed: int, folder: Path) -> Row:
    """Return the row of a recipe's name, with "-covering" or "-surest" of other hypotheses, or of what needs none.

    Raises:
        SettingsError: there is no such recipe.
        BaselineError: a seed of what is not trained.
    """
    if recipe == retrieval.METHOD:
        if seed:
            raise BaselineError(f"--seed {seed}: {recipe} draws nothing at random; leave it out")
        return Retrieval(recipe, tier, seed, folder)
    trained, _, hypotheses = recipe.rpartition("-")
    if hypotheses not in TITLES or not MODEL_KINDS[load_recipe(trained).base["model"]].chooses_hypotheses:
        trained, hypotheses = recipe, BALANCED
    load_recipe(trained)
    return Row(trained, tier, seed, folder, hypotheses)
