"""docs/baselines.py: a row by the commands that its file names, each once, from what was made here or elsewhere."""

import dataclasses
import json
import shutil
import tomllib
from types import SimpleNamespace

import baseline_rows
import baselines
import pytest
from bench_sets import small_set
from click.testing import CliRunner
from made_boards import FILES, IMAGES, turned
from symsol_annot_cli.score import score

from symsol_annot.bench.leaderboard.results import read_leaderboard
from symsol_annot.bench.leaderboard.rows import tables_of
from symsol_annot.bench.models.recipe import load_recipe
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.bench.scoring.reports.scores_file import read_scores, write_scores
from symsol_annot.errors import WeightsError

RECIPE = "small-wta"
NOTES = 'a "quote", a \\ and an é,\non two lines'
EPOCH = {"epoch": 1.0, "loss": 0.1, "learning_rate": 0.1, "seconds": 60.0, "processor_seconds": 90.0}


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("sets"), "tetX", IMAGES)


@pytest.fixture
def board(images, tmp_path):
    """A board whose small tier is a set of one object, without results."""
    place = tmp_path / "board" / "small"
    place.mkdir(parents=True)
    shutil.copy(FILES / "thesis.toml", place.parent)
    (place / "set.toml").write_text(
        f'title = "Small"\nsplit = "test"\nimages = {IMAGES}\ncommands = ["symsol-annot render --object tetX"]\n'
        f'[fingerprints]\ntetX = "{images.fingerprint}"\n'
    )
    return place.parent


@pytest.fixture
def made(board, images, tmp_path, monkeypatch):
    """A working folder with the set; commands run in it in this process, but for training, which writes a record."""
    folder = tmp_path / "work"
    (folder / "small").mkdir(parents=True)
    (folder / "small" / "tetX").symlink_to(images.folder)
    ran = []

    def run(place, words):
        ran.append(" ".join(words))
        if words[1] == "train":
            seed = int(words[words.index("--seed") + 1]) if "--seed" in words else 0
            train_elsewhere(place, seed)
        elif words[1] == "retrieve":
            write_hypotheses(place / words[-1], images, turned(images, 0.1), method="retrieval", progress=False)
        elif words[1] == "predict":
            seed = json.loads((place / words[2] / "weights.safetensors").read_text())["seed"]
            path = place / words[words.index("--out") + 1]
            write_hypotheses(path, images, turned(images, 0.05 + 0.01 * seed), method=RECIPE, progress=False)
        else:
            monkeypatch.chdir(place)
            done = CliRunner().invoke(score, words[2:])
            assert done.exit_code == 0, done.output

    def read_record(file):
        if not file.is_file():
            raise WeightsError(f"{file}: there is no such checkpoint")
        return record_of(**json.loads(file.read_text()))

    monkeypatch.setattr(baseline_rows, "BOARD", board)
    monkeypatch.setattr(baselines, "run", run)
    monkeypatch.setattr(baselines, "read_record", read_record)
    return SimpleNamespace(folder=folder, ran=ran, board=board, place=board / "small")


def record_of(seed=0, done=2, device="cpu Some Processor, 2 threads", name=RECIPE):
    recipe = load_recipe(RECIPE).for_object("tetX", has_marking=True)
    return SimpleNamespace(
        name=name,
        recipe=dataclasses.replace(recipe, input_size=32),
        object="tetX",
        image_size=(64, 64),
        seed=seed,
        epochs=2,
        epochs_done=done,
        is_finished=done == 2,
        first_stage="random, sha256 0",
        rows=(EPOCH,) * done,
        software={"device": device, "torch": "2.0", "symsol-annot": "1.0"},
    )


def train_elsewhere(folder, seed=0, **facts):
    """Put a checkpoint there, as far as these tests read one."""
    place = folder / "runs" / (f"tetX-{RECIPE}-seed-{seed}" if seed else f"tetX-{RECIPE}")
    place.mkdir(parents=True, exist_ok=True)
    (place / "weights.safetensors").write_text(json.dumps({"seed": seed, **facts}))


def make(made, seed=0, steps=baselines.STEPS):
    baselines.make(baseline_rows.row_of(RECIPE, "small", seed, made.folder), None, steps)


def account(made, name=RECIPE):
    return tomllib.loads((made.place / f"{name}.toml").read_text())


def test_one_call_makes_a_row_by_the_commands_that_it_names(made):
    make(made)
    assert made.ran == account(made)["commands"]
    assert [words.split()[1] for words in made.ran] == ["train", "predict", "score"]
    (result,) = read_leaderboard(made.board).results["small"]
    assert (result.name, result.scores_file) == (RECIPE, f"{RECIPE}.json.gz")
    training = result.account.objects["tetX"]
    assert (training.seed, training.minutes, training.processor_minutes) == (0, 2.0, 3.0)
    assert training.first_stage == "random"
    assert training.predictions_sha256 == result.scores["tetX"]["predictions"]["sha256"]
    assert training.predict_minutes is not None
    assert result.account.score_minutes is not None
    assert result.account.input_px == 32  # which the recipe reduces images to
    assert "Some Processor, 2 threads" in result.account.hardware
    assert read_scores(made.place / f"{RECIPE}.json.gz")["objects"]["tetX"]["per_image"]["decimals"] == 5


def test_a_row_that_needs_no_training_is_predicted_and_scored_once(made):
    row = baseline_rows.row_of("retrieval", "small", 0, made.folder)
    for _ in range(2):
        baselines.make(row, None, baselines.STEPS)
        assert [words.split()[1] for words in made.ran] == ["retrieve", "score"]
    assert made.ran == account(made, "retrieval")["commands"]
    (result,) = read_leaderboard(made.board).results["small"]
    assert (result.account.input_px, result.account.given_group, result.account.given_sets) == (16, False, True)
    assert (result.account.recipe, result.account.objects["tetX"].minutes) == ("", 0.0)
    assert result.account.objects["tetX"].predict_minutes is not None
    with pytest.raises(baseline_rows.BaselineError, match="--seed 1: retrieval draws nothing at random"):
        baseline_rows.row_of("retrieval", "small", 1, made.folder)


def test_nothing_that_is_finished_is_done_again(made):
    make(made)
    before = {path: path.read_bytes() for path in made.place.iterdir()}
    made.ran.clear()
    make(made)
    assert made.ran == []
    assert {path: path.read_bytes() for path in made.place.iterdir()} == before


@pytest.mark.parametrize("stopped_at", ["train", "predict", "score"])
def test_a_row_that_was_stopped_goes_on_at_that_step(stopped_at, made, monkeypatch):
    run = baselines.run

    def stop(place, words):
        if words[1] == stopped_at:
            raise KeyboardInterrupt
        run(place, words)

    monkeypatch.setattr(baselines, "run", stop)
    with pytest.raises(KeyboardInterrupt):
        make(made)
    monkeypatch.setattr(baselines, "run", run)
    make(made)
    assert [words.split()[1] for words in made.ran] == ["train", "predict", "score"]


def test_an_unfinished_training_is_resumed_and_not_predicted_before(made):
    train_elsewhere(made.folder, done=1)
    with pytest.raises(baseline_rows.BaselineError, match="has 1 epochs of 2; --only train resumes it"):
        make(made, steps=["predict"])
    make(made)
    assert made.ran[0].startswith("symsol-annot train")


def test_a_row_of_a_checkpoint_and_predictions_from_another_machine(made, images):
    train_elsewhere(made.folder, device="cuda Some GPU")
    path = made.folder / f"tetX-{RECIPE}.h5"
    write_hypotheses(path, images, turned(images, 0.07), method=RECIPE, progress=False)
    make(made)
    assert [words.split()[1] for words in made.ran] == ["score"]
    assert account(made)["hardware"] == "GPU Some GPU; torch 2.0, symsol-annot 1.0"
    assert "predict_minutes" not in account(made)["objects"]["tetX"]


def test_what_predicted_elsewhere_than_it_was_trained_is_told(made):
    train_elsewhere(made.folder, device="cuda Some GPU")
    make(made)
    assert account(made)["hardware"].startswith("GPU Some GPU; predicting on ")


def test_predictions_by_other_weights_are_made_and_scored_again(made):
    make(made)
    made.ran.clear()
    train_elsewhere(made.folder, device="cuda Some GPU")
    make(made)
    assert [words.split()[1] for words in made.ran] == ["predict"]  # equal bytes, so that the scores are theirs


def test_seeds_are_results_of_one_row(made):
    for seed in (0, 1, 2):
        make(made, seed)
    assert {path.name for path in made.place.glob("*.toml")} == {
        "set.toml",
        *(f"{RECIPE}{end}.toml" for end in ("", "-seed-1", "-seed-2")),
    }
    assert "--seed 1 --out runs/tetX-small-wta-seed-1" in account(made, f"{RECIPE}-seed-1")["commands"][0]
    table = tables_of(read_leaderboard(made.board), "small")[0]
    (row,) = table.rows
    assert len(row.names) == 3
    assert row.seed_range is not None
    assert row.seed_range[0] <= row.seed_range[1]


def test_a_checkpoint_of_another_seed_or_recipe_is_refused(made):
    train_elsewhere(made.folder, name="small-ewta")
    with pytest.raises(baseline_rows.BaselineError, match="recipe: expected 'small-wta', found 'small-ewta'"):
        make(made)


def test_another_set_than_the_boards_is_refused(made):
    file = made.place / "set.toml"
    file.write_text(file.read_text().replace('tetX = "', 'tetX = "0'))
    with pytest.raises(baseline_rows.BaselineError, match="its test split is not that of"):
        make(made)
    assert made.ran == []


def test_an_object_that_the_tier_lacks_is_refused(made):
    with pytest.raises(baseline_rows.BaselineError, match="--object cube: the small tier has tetX"):
        baselines.make(baseline_rows.row_of(RECIPE, "small", 0, made.folder), ["cube"], baselines.STEPS)


def test_nothing_to_score_or_to_write_is_told(made):
    with pytest.raises(baseline_rows.BaselineError, match="has no predictions of small-wta to score"):
        make(made, steps=["score"])
    with pytest.raises(baseline_rows.BaselineError, match="is missing; --only score makes it"):
        make(made, steps=["write"])


def test_a_row_that_is_made_again_keeps_the_notes_of_its_file(made):
    make(made)
    assert "notes" not in account(made)
    file = made.place / f"{RECIPE}.toml"
    file.write_text(f"notes = {json.dumps(NOTES)}\n{file.read_text()}")
    make(made)
    assert account(made)["notes"] == NOTES


def test_objects_that_a_result_has_already_are_kept_when_others_are_added(made):
    make(made)
    before, scores_file = account(made)["objects"]["tetX"], made.place / f"{RECIPE}.json.gz"
    earlier = read_scores(scores_file)
    write_scores(scores_file, {**earlier, "objects": {"cylO": earlier["objects"]["tetX"]}})
    for file in (made.place / f"{RECIPE}.toml", made.place / "set.toml"):
        file.write_text(file.read_text().replace("tetX", "cylO").replace('.h5",', '.h5 --compile",'))
    with (made.place / "set.toml").open("a") as file:
        file.write(f'tetX = "{earlier["objects"]["tetX"]["fingerprint"]}"\n')
    minutes = account(made)["score_minutes"]
    baselines.make(baseline_rows.row_of(RECIPE, "small", 0, made.folder), ["tetX"], baselines.STEPS)
    assert account(made)["objects"] == {"cylO": before, "tetX": before}
    assert account(made)["score_minutes"] == pytest.approx(2 * minutes, abs=0.11)
    *of_objects, scored = account(made)["commands"]
    assert [words.split()[1] for words in (*of_objects, scored)] == [*("train", "predict") * 2, "score"]
    assert [words.endswith(" --compile") for words in of_objects] == [False, True, False, False]  # as it was made
    assert list(read_scores(scores_file)["objects"]) == ["cylO", "tetX"]
    make(made, steps=["write"])  # all of them are there: nothing is doubled
    assert account(made)["objects"] == {"cylO": before, "tetX": before}
    assert account(made)["score_minutes"] == pytest.approx(2 * minutes, abs=0.11)


@pytest.mark.parametrize(
    ("recipe", "tier", "objects", "told"),
    [
        ("small-wta", "small", ["cylO", "tetX"], (False, False)),
        ("small-classifier-hard-negatives", "small", ["tetX"], (True, True)),
        ("wta-von-mises", "published", ["tetX", "cylO"], (False, False)),
        ("mixture", "published", ["tet", "cube", "icosa", "cone", "cyl", "tetX", "cylO", "sphereX"], (True, True)),
        ("mixture-covering", "published", ["tetX", "cylO"], (True, True)),
        ("volume-classifier", "published", ["sphereX"], (False, True)),
    ],
)
def test_rows_of_the_repository_have_their_objects_and_say_what_they_are_told(recipe, tier, objects, told, tmp_path):
    row = baseline_rows.row_of(recipe, tier, 0, tmp_path)
    assert row.objects() == objects
    assert tuple(row.knowledge().values()) == told
