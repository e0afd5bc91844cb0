"""The page: rows and their order, what stands beside them, and words of unknown origin."""

import html
import json
import re
import shutil
import tomllib

import markdown
import numpy as np
import pytest
from click.testing import CliRunner
from made_boards import FILES, ROOT, change_of, edited, page_of, tables_of
from mkdocs.config import load_config
from scipy.spatial.transform import Rotation
from symsol_annot_cli.leaderboard import leaderboard

from symsol_annot.bench.leaderboard.results import read_leaderboard
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.bench.scoring.reference import score_row
from symsol_annot.bench.scoring.reports import report
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
        assert row[rows[0].index("F-measure at 5 deg&nbsp;↑")] == interval
        assert row[rows[0].index("accuracy at 5 deg&nbsp;↑")] == f"{accuracy['value']:.3f}"


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
    assert [row[rows[0].index("coverage at 5 deg&nbsp;↑")] for row in rows[3:]] == ["1.000", "1.000"]
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


def test_a_row_of_the_thesis_has_what_was_run_below_it_or_says_that_nothing_was(folder):
    page = page_of(folder)
    table = tables_of(page)["Table 5.2, precision: mean error, rad"]
    thesis = tomllib.loads((FILES / "thesis.toml").read_text())["tables"]["Table 5.2, precision: mean error, rad"]
    assert [row[0].strip("`") for row in table[2:] if row[1].startswith("thesis, M = 30")] == list(thesis["rows"])
    for recipe, values in thesis["rows"].items():
        row = next(row for row in table if row[0] == f"`{recipe}`")
        assert row[1] == "thesis, M = 30, 75"  # the icosahedron has 60 members
        assert row[2:] == ["" if np.isnan(value) else f"{value:.3f}" for value in values]
    rows = enumerate(table[:-1])  # the last is what ranks first
    here = {table[i - 1][0]: row for i, row in rows if row[1].startswith("here, ")}
    assert here["`ewta-von-mises`"] == [
        "`ewta-von-mises`",
        "here, tiny: near, M = 1",
        "",
        "",
        "",
        "",
        "",
        "**0.010**",
        "",
    ]
    assert here["`wta-von-mises`"][:2] == ["`small-wta`", "here, tiny: far, M = 1"]  # which stands for it
    assert "Not run here: `wta-cosine`, `rwta-cosine`, `rwta-von-mises`, `ewta-cosine`.\n" in page


def test_the_last_rows_beside_the_thesis_are_what_ranks_first_of_each_object(folder):
    tables = tables_of(page_of(folder))
    first = re.sub(r"^1\. \[.*?\]\(#tiny(.*?)\).*", r"\1", tables["tetX, hypotheses"][2][0])
    for title in ("Table 5.1, recall: mean error, rad", "Table 5.2, precision: accuracy at 5 degrees"):
        *_, before, row = tables[title]
        assert not before[1].startswith("first in rank")
        assert row[:2] == [f"<code>{first}</code>", "first in rank, tiny"]
        metric = {"Table 5.1": "recall_mean_error_rad", "Table 5.2": "accuracy_at_5_deg"}[title[:9]]
        scores = json.loads((folder / "tiny" / f"{first}.json").read_text())["objects"]["tetX"]["hypotheses"]["all"]
        shown = dict(zip(tables[title][0][2:], row[2:], strict=True))
        assert shown["tetX"] == f"**{scores[metric]['value']:.3f}**"
        assert shown["cube"] == ""


def test_each_result_by_a_recipe_has_its_row_beside_the_thesis(folder):
    place = folder / "tiny"
    shutil.copy(place / "far.toml", place / "z-again.toml")
    shutil.copy(place / "far.json", place / "z-again.json")
    edited(place / "z-again.json", "objects", "tetX", "predictions", "sha256", value="0" * 64)
    change_of("far.toml", '"small-wta"', '"wta-von-mises"')(place)  # by the recipe itself; the other by its small one
    rows = tables_of(page_of(folder))["Table 5.1, recall: mean error, rad"]
    at = next(i for i, row in enumerate(rows) if row[0] == "`wta-von-mises`")
    assert [row[:2] for row in rows[at + 1 : at + 3]] == [
        ["`wta-von-mises`", "here, tiny: far, M = 1"],
        ["`small-wta`", "here, tiny: z-again, M = 1"],
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
