"""Rows: seeds are put together, copies of the labels have no rank, many hypotheses are marked, chance wins nothing."""

import json
import re

import numpy as np
import pytest
from made_boards import add_result, change_of, edited, page_of, tables_of, turned
from scipy.spatial.transform import Rotation

from symsol_annot.bench.leaderboard.results import read_leaderboard
from symsol_annot.bench.leaderboard.rows import Mark
from symsol_annot.bench.leaderboard.rows import tables_of as board_tables
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.bench.scoring.reference import score_row
from symsol_annot.bench.scoring.reports import report
from symsol_annot.errors import ScoresError

SEEDS = {"seed-a": 1, "seed-b": 2, "seed-c": 3}
RANKED = "f_measure_at_5_deg"


def add(folder, images, name, hypotheses, keys="", seed=7):
    path = folder / f"{name}.h5"
    write_hypotheses(path, images, hypotheses, method=name, progress=False)
    add_result(folder / "tiny", name, path, images, keys, seed)
    path.unlink()


def blurred(images, count, error_rad, seed):
    """R_gt, so many times, each with an error of its own."""
    rng = np.random.default_rng(seed)
    noise = Rotation.from_rotvec(error_rad * rng.normal(size=(len(images) * count, 3))).as_matrix()
    return images.labels().rotation[:, None] @ noise.reshape(len(images), count, 3, 3)


def scores_of(folder, name):
    return json.loads((folder / "tiny" / f"{name}.json").read_text())["objects"]["tetX"]


def hypotheses_table(folder):
    return next(table for table in board_tables(read_leaderboard(folder), "tiny") if table.track == "hypotheses")


@pytest.fixture
def seeded(folder, images):
    """The board with a method of three seeds."""
    for name, seed in SEEDS.items():
        add(folder, images, name, blurred(images, 3, 0.08, seed), 'method = "m"\ninput_px = 64', seed)
    for file in (folder / "tiny").glob("seed-*.toml"):
        file.write_text(re.sub(r'title = ".*"', 'title = "Three"', file.read_text()))
    return folder


def test_results_of_one_method_are_one_row_of_their_mean_with_the_range_of_the_seeds(seeded):
    row = next(row for row in hypotheses_table(seeded).rows if row.title == "Three")
    values = [scores_of(seeded, name)["hypotheses"]["all"][RANKED]["value"] for name in SEEDS]
    assert row.figures[RANKED].value == pytest.approx(np.mean(values))
    assert row.seed_range == (min(values), max(values))
    assert row.names == tuple(SEEDS)
    lows = [scores_of(seeded, name)["hypotheses"]["all"][RANKED]["low"] for name in SEEDS]
    assert min(lows) < row.figures[RANKED].low < row.figures[RANKED].value
    shown = next(row for row in tables_of(page_of(seeded))["tetX, hypotheses"] if "Three" in row[0])
    assert shown[0].endswith("3 seeds: [1](#tinyseed-a), [2](#tinyseed-b), [3](#tinyseed-c)")
    assert shown[1:3] == ["3", "64"]
    assert f"seeds {min(values):.3f} to&nbsp;{max(values):.3f}" in shown[3]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (change_of("seed-b.toml", "seed = 2", "seed = 1"), "seed-b.toml: objects.tetX.seed: 1 is that of seed-a.toml"),
        (change_of("seed-b.toml", "input_px = 64", "input_px = 32"), "seed-b.toml: input_px: expected 64, as seed-a"),
        (change_of("seed-c.toml", '"Three"', '"Other"'), "seed-c.toml: title: expected 'Three', as seed-a.toml"),
    ],
)
def test_results_of_one_method_differ_in_their_seed_alone(change, said, seeded):
    change(seeded / "tiny")
    with pytest.raises(ScoresError, match=re.escape(said)):
        read_leaderboard(seeded)


def test_results_of_one_method_have_one_M(seeded, images):
    add(seeded, images, "seed-b", blurred(images, 2, 0.08, 2), 'method = "m"\ninput_px = 64', 2)
    change_of("seed-b.toml", "The seed-b one", "Three")(seeded / "tiny")
    with pytest.raises(ScoresError, match=r"seed-b\.json: objects\.tetX\.hypotheses\.M: expected 3, as seed-a"):
        read_leaderboard(seeded)


def test_lists_of_several_lengths_may_have_another_M_in_each_seed(folder, images):
    for name, seed, longest in (("seed-a", 0, 3), ("seed-b", 1, 2)):
        lists = blurred(images, longest, 0.08, seed)
        add(folder, images, name, lambda i, lists=lists: lists[i][: 1 + i % len(lists[i])], 'method = "m"', seed)
        change_of(f"{name}.toml", f"The {name} one", "Both")(folder / "tiny")
    (row,) = [row for row in hypotheses_table(folder).rows if row.title == "Both"]
    assert row.facts["M"] == 3
    assert len(row.names) == 2


def test_copies_of_the_truth_have_no_rank_and_say_so(folder, images):
    copies = np.repeat(images.labels().rotation[:, None], 720, axis=1)
    add(folder, images, "copies", copies)
    rows = tables_of(page_of(folder))["tetX, hypotheses"]
    assert [row[0][:2] for row in rows[2:]] == ["1.", "2.", "‡ "]
    assert rows[4][1] == "720&nbsp;†"
    assert "**" not in "".join(rows[4])
    assert "† More than 30 hypotheses per image. ‡ As exact as the labels: no rank." in page_of(folder)


def test_the_group_of_the_body_at_the_true_rotation_has_no_rank(folder, images):
    labels = images.labels()
    add(folder, images, "blind", labels.candidates)
    row = hypotheses_table(folder).rows[-1]
    assert (row.title, row.place) == ("The blind one", None)
    assert row.marks == {Mark.EXACT}


def test_an_error_that_pixels_tell_ranks(folder, images):
    add(folder, images, "small", turned(images, 0.0015))
    rows = hypotheses_table(folder).rows
    assert {row.title: row.place for row in rows} == {"The near one": 1, "The small one": 1, "The far one": 3}


@pytest.mark.parametrize(("count", "is_many"), [(30, False), (31, True)])
def test_more_hypotheses_than_the_thesis_has_are_marked(count, is_many, folder, images):
    add(folder, images, "many", blurred(images, count, 0.08, 0))
    row = next(row for row in hypotheses_table(folder).rows if row.title == "The many one")
    assert (Mark.MANY in row.marks) == is_many


def test_rows_that_differ_by_chance_alone_may_both_be_the_best(folder, images):
    for name in ("one", "two"):
        add(folder, images, name, blurred(images, 3, 0.08, len(name) + ord(name[0])))
    (folder / "tiny" / "near.toml").unlink()
    (folder / "tiny" / "near.json").unlink()
    table = hypotheses_table(folder)
    assert [Mark.MAY_BE_BEST in row.marks for row in table.rows] == [True, True, False]
    shown = tables_of(page_of(folder))["tetX, hypotheses"]
    assert shown[2][3].split("<br>")[0].endswith("**&nbsp;≈")
    assert "≈ With 95% confidence the best of these 3 is among the 2 with this sign." in page_of(folder)


def test_a_clear_winner_is_said_to_be_one(folder):
    table = hypotheses_table(folder)
    assert table.is_tested
    assert not any(row.marks for row in table.rows)
    assert "With 95% confidence the first is the best of these 2." in page_of(folder)


def test_rows_of_one_figure_share_a_place(folder, images):
    add(folder, images, "nearly", turned(images, -0.01))
    rows = hypotheses_table(folder).rows
    assert [row.place for row in rows] == [1, 1, 3]


def test_what_a_method_was_told_stands_in_its_row(folder):
    change_of("far.toml", "recipe =", "given_group = true\ngiven_sets = true\ninput_px = 128\nrecipe =")(
        folder / "tiny"
    )
    row = tables_of(page_of(folder))["tetX, hypotheses"][3]
    assert row[0].endswith("a lab<br>told group, sets")
    assert row[2] == "128"
    assert "It reads 128x128 pixels. It was told the body's group. It learnt from symmetry sets." in page_of(folder)


def test_references_stand_alone_where_nobody_sent_anything_in(folder, images, tmp_path):
    for file in (folder / "tiny").glob("*ar.*"):
        file.unlink()
    (folder / "tiny" / "reference").mkdir()
    (folder / "tiny" / "reference" / "uniform.json").write_text(
        report.to_json(score_row("uniform", [images], tmp_path, 0))
    )
    rows = tables_of(page_of(folder))["tetX, hypotheses"]
    assert [row[0] for row in rows[2:]] == ["*[30 uniform rotations](files/tiny/reference/uniform.json)*"]
    assert "px" not in rows[0]
    assert "Nobody has sent in a result on this set yet; the rows are references." in page_of(folder)


def test_a_figure_that_ranks_without_those_of_its_images_is_refused(folder):
    figure = {"value": 1.0, "low": 1.0, "high": 1.0, "images": 24, "undefined": 0}
    edited(
        folder / "tiny" / "far.json",
        "objects",
        "tetX",
        "hypotheses",
        "all",
        "f_measure_unweighted_at_5_deg",
        value=figure,
    )
    with pytest.raises(ScoresError, match=r"per_image\.hypotheses\.f_measure_unweighted_at_5_deg: is missing"):
        read_leaderboard(folder)
