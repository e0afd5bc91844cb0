"""The leaderboard shows what the files of results say, and refuses files that nobody could check."""

import html
import importlib.util
import json
import os
import re
import shutil
import tomllib
from pathlib import Path
from types import SimpleNamespace

import markdown
import numpy as np
import pytest
from click.testing import CliRunner
from made_boards import FILES, IMAGES, ROOT, change_of, edited, page_of, tables_of
from mkdocs.config import load_config
from scipy.spatial.transform import Rotation
from symsol_annot_cli.leaderboard import leaderboard

from symsol_annot.bench.leaderboard.results import read_leaderboard
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.bench.scoring import report
from symsol_annot.bench.scoring.metric import Place
from symsol_annot.bench.scoring.reference import score_row
from symsol_annot.bench.scoring.scorers.table import metrics_shown
from symsol_annot.bench.scoring.scores_file import figures_that_differ
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import ScoresError

NOTES = 'a "quote", a \\ and an é,\non two lines'


def test_the_page_of_the_repository_is_what_its_files_give(monkeypatch):
    monkeypatch.chdir(ROOT)
    done = CliRunner().invoke(leaderboard, ["docs/results/leaderboard", "--out", "docs/leaderboard.md", "--check"])
    assert done.exit_code == 0, done.exception


def test_rows_hold_the_figures_of_the_scores_the_best_first(folder):
    rows = tables_of(page_of(folder))["tetX, hypotheses"]
    assert [row[0] for row in rows[2:]] == [
        "1. [The near one](#tinynear)<br>a lab",
        "2. [The far one](#tinyfar)<br>a lab",
    ]
    for row, name in zip(rows[2:], ("near", "far"), strict=True):
        scores = json.loads((folder / "tiny" / f"{name}.json").read_text())["objects"]["tetX"]["hypotheses"]["all"]
        f, accuracy = (scores[f"{what}_at_5_deg"] for what in ("f_measure", "accuracy"))
        value = f"**{f['value']:.3f}**" if name == "near" else f"{f['value']:.3f}"
        interval = f"{value}<br>[{f['low']:.3f},&nbsp;{f['high']:.3f}]"
        assert row[rows[0].index("F-measure at 5 deg ↑")] == interval
        assert row[rows[0].index("accuracy at 5 deg ↑")] == f"{accuracy['value']:.3f}"


def test_figures_that_the_tables_leave_out_stand_with_how_a_result_was_made(folder):
    page = page_of(folder)
    rows = tables_of(page)["tiny/far"]
    scores = json.loads((folder / "tiny" / "far.json").read_text())["objects"]["tetX"]["hypotheses"]["all"]
    head = next(row for row in rows if row[0] == "hypotheses")
    column, row = head.index("precision mean error, rad (5.9) ↓"), rows[rows.index(head) + 2]
    assert row[column].startswith(f"{scores['precision_mean_error_rad']['value']:.4f} [")
    assert "[far.json](files/tiny/far.json)" in page
    assert "[far.toml](files/tiny/far.toml)" in page


def test_no_table_of_ranks_has_more_than_six_columns(folder):
    for title, rows in tables_of(page_of(folder)).items():
        if title.startswith("tetX, "):
            assert len(rows[0]) <= 6


def test_each_row_of_hypotheses_has_its_M(folder):
    rows = tables_of(page_of(folder))["tetX, hypotheses"]
    assert [row[rows[0].index("M")] for row in rows[2:]] == ["1", "1"]
    assert "M" not in tables_of(page_of(folder))["tetX, classifier"][0]


def test_nobody_ranks_first_by_listing_everything(folder, images, tmp_path):
    labels = images.labels()
    for ending in ("toml", "json"):
        (folder / "tiny" / f"far.{ending}").unlink()
    rng = np.random.default_rng(0)
    noise = Rotation.random(len(labels) * 400, random_state=rng).as_matrix().reshape(len(labels), 400, 3, 3)
    blurred = Rotation.from_rotvec([0.005, 0, 0]).as_matrix()  # as exact as the labels it would have no rank
    everything = np.concatenate([labels.rotation[:, None] @ labels.symmetry_group @ blurred, noise], axis=1)
    weights = np.full(everything.shape[:2], 1e-30)
    weights[:, 0] = 1.0  # the first is right; the others hardly count for precision, but fully for recall
    for name, given in {"listed": None, "weighted": weights}.items():
        path = tmp_path / f"{name}.h5"
        write_hypotheses(path, images, everything, method=name, weights=given, progress=False)
        document = report.to_document([score_file(path, images.folder)])
        (folder / "tiny" / f"{name}.json").write_text(report.to_json(document))
        toml = (folder / "tiny" / "near.toml").read_text().replace("The near one", f"The {name} one")
        (folder / "tiny" / f"{name}.toml").write_text(toml)
    page = page_of(folder)
    rows = tables_of(page)["tetX, hypotheses"]
    assert rows[2][0].startswith("1. [The near one]")
    assert [row[rows[0].index("M")] for row in rows[2:]] == ["1", "412&nbsp;†", "412&nbsp;†"]
    assert [row[rows[0].index("coverage at 5 deg ↑")] for row in rows[3:]] == ["1.000", "1.000"]
    assert "**What ranks**" in page
    assert "† More than 30 hypotheses per image." in page


def test_reference_rows_stand_below_the_results_without_a_rank(folder, images, tmp_path):
    (folder / "tiny" / "reference").mkdir()
    document = score_row("truth", [images], tmp_path, 0)  # on a grid that does not rank
    assert not document["ranks"]
    path = folder / "tiny" / "reference" / "truth.json"
    path.write_text(report.to_json(document))
    rows = tables_of(page_of(folder))["tetX, hypotheses"]
    assert [row[0][:15] for row in rows[2:4]] == ["1. [The near on", "2. [The far one"]
    assert rows[4][0] == "*[truth](files/tiny/reference/truth.json)*"
    assert rows[4][1:] == ["*9*", "", "*1.000<br>[1.000,&nbsp;1.000]*", "*1.000*", "*1.000*"]
    edited(path, "objects", "tetX", "fingerprint", value="0" * 64)
    with pytest.raises(ScoresError, match=r"reference/truth\.json: .*fingerprint: expected"):
        read_leaderboard(folder)


def test_code_may_stand_in_place_of_commands(folder):
    change_of("far.toml", 'commands = ["./far.sh"]', 'code = "https://example.org/far"')(folder / "tiny")
    assert "[code](https://example.org/far)" in page_of(folder)
    change_of("far.toml", 'code = "https://example.org/far"', 'code = " "')(folder / "tiny")
    with pytest.raises(ScoresError, match="commands, code: one of them has to say"):
        read_leaderboard(folder)


@pytest.mark.parametrize(
    "words", ["::: symsol_annot", "!!! note", "# heading", "<script>alert(1)</script>", "[x](javascript:1)"]
)
def test_hostile_words_in_every_field_are_words_on_the_built_page(words, folder):
    quoted = json.dumps(words)
    place = folder / "tiny"
    change_of("far.toml", '"The far one"', quoted)(place)
    change_of("far.toml", '"a lab"', quoted)(place)
    change_of("far.toml", '"an abacus"', f"{quoted}\nnotes = {quoted}")(place)
    change_of("far.toml", 'commands = ["./far.sh"]', f"commands = [{json.dumps('```')}, {quoted}]")(place)
    change_of("far.toml", "minutes = 3.25", f"minutes = 3.25\nfirst_stage = {quoted}")(place)
    change_of("set.toml", 'title = "Tiny"', f"title = {quoted}\nnotes = {quoted}")(place)
    config = load_config(str(ROOT / "mkdocs.yml"))
    page = markdown.markdown(
        page_of(folder), extensions=config.markdown_extensions, extension_configs=config.mdx_configs
    )
    shown = html.unescape(re.sub(r"<[^>]*>", "", page))
    assert shown.count(words) == 12  # two rows' titles and names, four facts, a command, a first stage, a set's two
    assert not re.search(r"<script|javascript:1\"|admonition|doc ", page)
    assert page.count("<pre") == 4  # of the set, of two results, and of the example


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = " + "[" * 100_000, "cannot be read"),
        ("x = 1\n" * 60_000, "larger than"),
        ("\n".join(f"k{i} = 1" for i in range(5_000)), " faults more"),
        ("title = " + json.dumps("x" * 30_000) + "\ndate = " + json.dumps("y" * 30_000), "date: expected a date"),
        ('"\\u001b[2J" = 1', r"'\x1b[2J': is no key of a result"),
        ("\x00", "cannot be read"),
    ],
)
def test_a_hostile_toml_ends_in_a_short_message(text, said, folder):
    (folder / "tiny" / "far.toml").write_text(text)
    with pytest.raises(ScoresError) as refused:
        read_leaderboard(folder)
    assert said in str(refused.value)
    assert len(str(refused.value)) < 10_000
    assert all(line.isprintable() for line in str(refused.value).splitlines())


def test_what_an_operating_system_leaves_in_folders_is_passed_over(folder):
    (folder / ".git").mkdir()
    (folder / "tiny" / "._far.toml").write_bytes(b"\x00")
    (folder / "tiny" / ".DS_Store").write_bytes(b"\x00")
    read_leaderboard(str(folder))


def test_a_row_of_the_thesis_has_what_was_run_below_it_or_says_that_nothing_was(folder):
    page = page_of(folder)
    table = tables_of(page)["Table 5.2, precision: mean error, rad"]
    thesis = tomllib.loads((FILES / "thesis.toml").read_text())["tables"]["Table 5.2, precision: mean error, rad"]
    assert [row[0].strip("`") for row in table[2:] if row[1].startswith("thesis, M = 30")] == list(thesis["rows"])
    for recipe, values in thesis["rows"].items():
        row = next(row for row in table if row[0] == f"`{recipe}`")
        assert row[1] == "thesis, M = 30, 75"  # the icosahedron has 60 members
        assert row[2:] == ["" if np.isnan(value) else f"{value:.3f}" for value in values]
    here = {table[i - 1][0]: row for i, row in enumerate(table) if row[1].startswith("here, ")}
    assert here["`ewta-von-mises`"] == [
        "`ewta-von-mises`",
        "here, tiny/near, M = 1",
        "",
        "",
        "",
        "",
        "",
        "**0.010**",
        "",
    ]
    assert here["`wta-von-mises`"][:2] == ["`small-wta`", "here, tiny/far, M = 1"]  # which stands for it
    assert "Not run here: `wta-cosine`, `rwta-cosine`, `rwta-von-mises`, `ewta-cosine`.\n" in page


def test_each_result_by_a_recipe_has_its_row_beside_the_thesis(folder):
    place = folder / "tiny"
    shutil.copy(place / "far.toml", place / "z-again.toml")
    shutil.copy(place / "far.json", place / "z-again.json")
    edited(place / "z-again.json", "objects", "tetX", "predictions", "sha256", value="0" * 64)
    change_of("far.toml", '"small-wta"', '"wta-von-mises"')(place)  # by the recipe itself; the other by its small one
    rows = tables_of(page_of(folder))["Table 5.1, recall: mean error, rad"]
    at = next(i for i, row in enumerate(rows) if row[0] == "`wta-von-mises`")
    assert [row[:2] for row in rows[at + 1 : at + 3]] == [
        ["`wta-von-mises`", "here, tiny/far, M = 1"],
        ["`small-wta`", "here, tiny/z-again, M = 1"],
    ]


def test_how_a_result_was_made_stands_on_the_page(folder):
    page = page_of(folder)
    sha256 = json.loads((folder / "tiny" / "far.json").read_text())["objects"]["tetX"]["predictions"]["sha256"]
    assert tables_of(page)["tiny/far"][2] == ["tetX", "7", "3.2", "", ""]
    assert tables_of(page)["tiny/far"][5] == ["tetX", f"`{sha256}`"]
    assert "./far.sh" in page
    assert "an abacus" in page


def test_words_of_unknown_origin_are_text(folder):
    file = folder / "tiny" / "near.toml"
    file.write_text(file.read_text().replace("The near one", "a | b <script>x</script> [y](z)\\n# h"))
    page = page_of(folder)
    assert "<script>" not in page
    assert "[y](z)" not in page
    assert "\n# h" not in page
    row = next(line for line in page.splitlines() if "script" in line and line.startswith("|"))
    assert len(re.split(r"(?<!\\)\|", row)) == 2 + len(tables_of(page)["tetX, hypotheses"][0])


def test_a_set_of_unknown_origin_is_text(folder):
    title = 'title = "Tiny"\n'
    change_of("set.toml", title, title + r'notes = "<script>x</script> [y](z)\n\u202e# `h`"' + "\n")(folder / "tiny")
    line = next(line for line in page_of(folder).splitlines() if "of the test split" in line)
    assert html.unescape(line).endswith("of the test split. <script>x</script> [y](z) # `h`")
    assert not set(line) & set("<>[]`")


@pytest.mark.parametrize("name", ["a|b", "[x](http:evil)", "<b>", "a b", "é", "a\nb", "`"])
def test_names_that_would_be_more_than_text_on_the_page_are_refused(name, folder):
    place, new = folder / "tiny", name.replace("/", "")
    for ending in ("toml", "json"):
        (place / f"far.{ending}").rename(place / f"{new}.{ending}")
    place.rename(folder / f"set{new}")
    with pytest.raises(ScoresError, match=r"the leaderboard has 2 faults") as refused:
        read_leaderboard(folder)
    for unfit in (f"set{new}", new):
        assert f": {unfit!r}: a name has letters, digits, '.', '_' and '-' alone" in str(refused.value)


@pytest.mark.parametrize("file", ["set.toml", "far.toml", "far.json"])
def test_a_pipe_in_place_of_a_file_is_refused_and_not_waited_for(file, folder):
    path = folder / "tiny" / file
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(ScoresError, match=rf"{file}: .*regular file"):
        read_leaderboard(folder)


def without_figures(track, metric):
    """Leave a metric out of all that an object's scores say."""

    def change(place):
        document = json.loads((place / "far.json").read_text())
        entry = document["objects"]["tetX"]
        for table in (*(entry[track][s] for s in ("all", *entry["per_image"]["strata"])), entry["per_image"][track]):
            del table[metric]
        (place / "far.json").write_text(json.dumps(document))

    return change


@pytest.mark.parametrize("track", ["hypotheses", "classifier"])
def test_no_figure_of_the_page_can_be_left_out(track, folder):
    for metric in metrics_shown(track, Place.LEADERBOARD):
        board = Path(shutil.copytree(folder, folder.parent / metric.name))
        without_figures(track, metric.name)(board / "tiny")
        with pytest.raises(ScoresError, match=rf"has 1 fault:\n.*per_image\.{track}\.{metric.name}: is missing"):
            read_leaderboard(board)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ('track = "classifier"', 'track = "guesses"', "track: expected one of hypotheses, classifier, density, found"),
        ('metric = "f_measure"', 'metric = "accuracy"', "metric: expected one of recall, precision, f_measure"),
        (
            "wta-cosine = [0.018,",
            "wta-cosine = [0.018, 0.5,",
            "rows.wta-cosine: expected a number per object, 7, found 8",
        ),
        ("ewta-cosine = [0.942,", "ewta-cosine = [", "rows.ewta-cosine: expected a number per object, 7, found 6"),
        ("ewta-cosine = [0.942,", "'<b>' = [0.942,", "rows: there is no recipe '<b>' built in"),
        ('["tet", ', '["<b>", ', "objects: '<b>': an object's name has 1 to 64 letters"),
        ('= "small-ewta"', '= "small-etwa"', "small.ewta-von-mises: there is no recipe 'small-etwa' built in"),
    ],
)
def test_tables_of_the_thesis_that_do_not_fit_are_refused(before, after, said, folder):
    file = folder / "thesis.toml"
    assert before in file.read_text()
    file.write_text(file.read_text().replace(before, after, 1))
    with pytest.raises(ScoresError, match=rf"thesis\.toml: .*{re.escape(said)}"):
        read_leaderboard(folder)


def scores_with(*keys, value):
    return lambda place: edited(place / "far.json", *keys, value=value)


RECALL = ("objects", "tetX", "hypotheses", "all", "recall_mean_error_rad")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (scores_with(*RECALL, "value", value=0.001), "all.recall_mean_error_rad.value: says 0.001, its images give"),
        (scores_with(*RECALL, "low", value=None), "all.recall_mean_error_rad.low: says None, its images give"),
        (
            scores_with("objects", "tetX", "hypotheses", "shown", "accuracy_at_5_deg", "value", value=1),
            "shown.accuracy",
        ),
        (scores_with("ranks", value=False), "'ranks' is not true"),
        (
            scores_with("objects", "tetX", "classifier", "warnings", value=["w"]),
            "tetX.classifier.warnings: does not rank",
        ),
        (scores_with("objects", "tetX", "fingerprint", value="0" * 64), "fingerprint: expected"),
        (scores_with("objects", "tetX", "split", value="train"), "split: expected test, found 'train'"),
        (scores_with("objects", "tetX", "predictions", value={"sha256": "?"}), "predictions.sha256: is no SHA-256"),
        (scores_with("format", value="x"), "is no scores file"),
        (lambda place: (place / "far.json").unlink(), "far.json: cannot be read"),
        (lambda place: (place / "far.toml").unlink(), "far.toml: cannot be read"),
        (lambda place: (place / "set.toml").unlink(), "set.toml: cannot be read"),
        (lambda place: (place / "far.json").write_text("{"), "is no JSON"),
        (lambda place: shutil.copy(place / "near.json", place / "far.json"), "are those of tiny/far"),
        (change_of("far.toml", "seed = 7", ""), "far.toml: objects.tetX.seed: is missing"),
        (change_of("far.toml", "seed = 7", "seed = 7.5"), "objects.tetX.seed: expected a whole number, found 7.5"),
        (
            change_of("far.toml", "objects.tetX", "objects.cube"),
            "objects: expected those of the scores, tetX, found cube",
        ),
        (change_of("far.toml", "2026-01-02", '"today"'), "date: expected a date, found 'today'"),
        (change_of("far.toml", '"./far.sh"', ""), "commands, code: one of them has to say"),
        (
            change_of("far.toml", 'commands = ["./far.sh"]', 'code = "see our paper"'),
            "code: expected an address that begins with https://, found 'see our paper'",
        ),
        (
            change_of("far.toml", '"./far.sh"]', '"./far.sh"]\ncode = "https://e.org/)[x](javascript:1)"'),
            "code: expected an address",
        ),
        (
            change_of("far.toml", "recipe =", "input_px = 0\nrecipe ="),
            "input_px: expected 1 to 16384 pixels, found 0",
        ),
        (change_of("far.toml", "recipe =", "given_group = 1\nrecipe ="), "given_group: expected"),
        (change_of("far.toml", '"small-wta"', '"mine"'), "recipe: there is no 'mine' built in"),
        (change_of("far.toml", '"a lab"', '" "'), "by: is empty"),
        (change_of("far.toml", "by =", "from ="), "from: is no key of a result; keys are title, by"),
        (change_of("far.toml", "by =", "by"), "far.toml: cannot be read"),
        (change_of("far.toml", '"a lab"', 5000 * "[" + 5000 * "]"), "far.toml: cannot be read: "),
        (change_of("far.toml", "seed = 7", "seed = -3"), "objects.tetX.seed: expected 0 or more, found -3"),
        (
            change_of("far.toml", "seed = 7", f"seed = 0x{5000 * 'f'}"),
            "far.toml: cannot be read: it holds an integer beyond 64 bits",
        ),
        (change_of("far.toml", "seed = 7", f"seed = {5000 * '9'}"), "far.toml: cannot be read: "),
        (change_of("far.toml", "3.25", "nan"), "objects.tetX.minutes: expected a finite number, 0 or more, found nan"),
        (change_of("far.toml", "3.25", "-1"), "objects.tetX.minutes: expected a finite number, 0 or more, found -1.0"),
        (
            change_of("far.toml", "3.25", "1\nprocessor_minutes = inf"),
            "objects.tetX.processor_minutes: expected a finite number, 0 or more, found inf",
        ),
        (change_of("set.toml", f"images = {IMAGES}", "images = 0"), "set.toml: images: expected 1 or more, found 0"),
        (change_of("set.toml", '"test"', '"<b>"'), "set.toml: split: expected one of train, test, found '<b>'"),
        (change_of("set.toml", "tetX =", "'<b>' ="), "set.toml: fingerprints: '<b>': an object's name has"),
        (scores_with(*RECALL, value={"value": 0.1}), "all.recall_mean_error_rad has no value with an interval"),
        (scores_with("objects", "tetX", "per_image", "strata", value={"all": [0]}), "strata has others than shown"),
        (change_of("set.toml", f"images = {IMAGES}", "images = 1"), f"images: expected 1, found {IMAGES}"),
        (change_of("set.toml", "tetX =", "cube ="), "fingerprint: expected None"),
    ],
)
def test_files_that_nobody_could_check_are_refused(change, said, folder):
    change(folder / "tiny")
    with pytest.raises(ScoresError, match=re.escape(said)):
        read_leaderboard(folder)


def test_all_faults_are_told_at_once(folder):
    (folder / "tiny" / "far.toml").unlink()
    edited(folder / "tiny" / "near.json", "ranks", value=False)
    with pytest.raises(ScoresError, match=r"the leaderboard has 2 faults:\n(.*\n)*.*'ranks' is not true"):
        read_leaderboard(folder)


def test_no_figure_differs_in_what_score_wrote(folder):
    for name in ("near", "far"):
        document = json.loads((folder / "tiny" / f"{name}.json").read_text())
        assert list(figures_that_differ(document["objects"]["tetX"])) == []


def test_check_writes_nothing_and_fails_where_the_page_is_old(folder, tmp_path):
    page = tmp_path / "page.md"
    run = CliRunner()
    assert isinstance(run.invoke(leaderboard, [str(folder), "--out", str(page), "--check"]).exception, ScoresError)
    assert not page.exists()
    assert run.invoke(leaderboard, [str(folder), "--out", str(page)]).exit_code == 0
    before = page.read_bytes()
    assert run.invoke(leaderboard, [str(folder), "--out", str(page), "--check"]).exit_code == 0
    (folder / "tiny" / "far.toml").unlink()
    (folder / "tiny" / "far.json").unlink()
    refused = run.invoke(leaderboard, [str(folder), "--out", str(page), "--check"])
    assert "is not what" in str(refused.exception)
    assert "\n--- " in str(refused.exception)
    assert "\n-| 2. [The far one](#tinyfar)<br>a lab | 1 |" in str(refused.exception)
    assert page.read_bytes() == before


@pytest.fixture
def baselines():
    """docs/baselines.py, with trainings that took a minute each."""
    found = importlib.util.spec_from_file_location("baselines", ROOT / "docs" / "baselines.py")
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    row = {"seconds": 60.0, "processor_seconds": 30.0}
    record = SimpleNamespace(rows=(row,), seed=0, first_stage="random", software={"device": "cpu x", "torch": "2"})
    module.read_record = lambda _: record
    return module


def test_a_baseline_that_is_made_again_keeps_the_notes_of_its_file(baselines, tmp_path):
    baselines.PLACE = tmp_path
    (tmp_path / "small-wta.toml").write_text(f"notes = {json.dumps(NOTES)}\n")
    assert tomllib.loads(baselines.result("small-wta", tmp_path))["notes"] == NOTES
    assert "notes" not in tomllib.loads(baselines.result("small-rwta", tmp_path))


def test_a_folder_without_the_thesis_is_no_leaderboard(tmp_path):
    with pytest.raises(ScoresError, match=r"is no leaderboard's folder: it has no thesis\.toml"):
        read_leaderboard(tmp_path)
