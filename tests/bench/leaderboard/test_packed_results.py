"""Results whose scores are packed, or rounded per image: the same page, the same checks, the same rescoring."""

import gzip
import json

import pytest
from click.testing import CliRunner
from made_boards import change_of, edited, page_of, turned
from symsol_annot_cli.leaderboard import leaderboard

from symsol_annot.bench.leaderboard.rescoring import rescore
from symsol_annot.bench.leaderboard.results import read_leaderboard
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.bench.scoring.reference import score_row
from symsol_annot.bench.scoring.reports import report
from symsol_annot.bench.scoring.reports.scores_file import write_scores
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import ScoresError

DECIMALS = 5


def packed(path):
    """Put a packed file in the place of a plain one."""
    document = json.loads(path.read_text())
    path.unlink()
    write_scores(path.with_name(f"{path.name}.gz"), document)


@pytest.fixture
def rounded(folder, images, tmp_path):
    """The board with one result more, packed and rounded, and its predictions."""
    predictions = tmp_path / "mine.h5"
    write_hypotheses(predictions, images, turned(images, 0.0512345678), method="mine")
    document = report.to_document([score_file(predictions, images.folder)], DECIMALS)
    write_scores(folder / "tiny" / "mine.json.gz", document)
    toml = (folder / "tiny" / "near.toml").read_text().replace("The near one", "Mine")
    (folder / "tiny" / "mine.toml").write_text(toml)
    return folder, predictions


def changed(path, *keys, value):
    """Change one value of a packed file."""
    plain = path.with_suffix("")
    plain.write_bytes(gzip.decompress(path.read_bytes()))
    edited(plain, *keys, value=value)
    packed(plain)


def test_packed_scores_give_the_page_of_plain_ones_with_links_to_what_is_there(folder, images, tmp_path):
    (folder / "tiny" / "reference").mkdir()
    write_scores(folder / "tiny" / "reference" / "truth.json", score_row("truth", [images], tmp_path, 0))
    plain = page_of(folder)
    for file in ("far.json", "reference/truth.json"):
        packed(folder / "tiny" / file)
    assert page_of(folder) == (
        plain.replace("[far.json](files/tiny/far.json)", "[far.json.gz](files/tiny/far.json.gz)").replace(
            "reference/truth.json", "reference/truth.json.gz"
        )
    )


@pytest.mark.parametrize("place", ["tiny", "tiny/reference"])
def test_one_result_has_one_file_of_scores(place, folder):
    (folder / place).mkdir(exist_ok=True)
    (folder / place / "far.json.gz").write_bytes(gzip.compress((folder / "tiny" / "far.json").read_bytes()))
    (folder / place / "far.json").write_bytes((folder / "tiny" / "far.json").read_bytes())
    with pytest.raises(ScoresError, match=r"has both far\.json and far\.json\.gz; keep one of them"):
        read_leaderboard(folder)


def test_faults_of_packed_scores_name_the_packed_file(folder):
    packed(folder / "tiny" / "far.json")
    changed(folder / "tiny" / "far.json.gz", "ranks", value=False)
    with pytest.raises(ScoresError, match=r"tiny/far\.json\.gz: 'ranks' is not true"):
        read_leaderboard(folder)
    (folder / "tiny" / "far.toml").unlink()
    with pytest.raises(ScoresError, match=r"far\.toml: cannot be read"):
        read_leaderboard(folder)


def test_rounded_figures_of_images_bear_their_means_and_no_others(rounded):
    folder, _ = rounded
    read_leaderboard(folder)
    keys = ("objects", "tetX", "hypotheses", "all", "recall_mean_error_rad", "value")
    path = folder / "tiny" / "mine.json.gz"
    value = json.loads(gzip.decompress(path.read_bytes()))["objects"]["tetX"]["hypotheses"]["all"][keys[-2]]["value"]
    changed(path, *keys, value=value + 1e-6)  # which rounding may be
    read_leaderboard(folder)
    changed(path, *keys, value=value - 2e-5)
    with pytest.raises(ScoresError, match=r"mine\.json\.gz: .*recall_mean_error_rad\.value: says"):
        read_leaderboard(folder)


@pytest.mark.parametrize("decimals", [4, 13, True, "5", None])
def test_rounding_that_would_hide_a_figure_is_refused(decimals, rounded):
    folder, _ = rounded
    changed(folder / "tiny" / "mine.json.gz", "objects", "tetX", "per_image", "decimals", value=decimals)
    with pytest.raises(ScoresError, match=r"mine\.json\.gz: .*\n.*per_image\.decimals: expected 5 to 12"):
        read_leaderboard(folder)


def test_predictions_of_a_packed_and_rounded_row_give_its_figures_again(rounded, images):
    folder, predictions = rounded
    done = CliRunner().invoke(leaderboard, [str(folder), "--rescore", str(predictions), "--data", str(images.folder)])
    assert done.exit_code == 0, done.exception
    assert "equal to tiny/mine in all" in done.output


def test_a_figure_of_a_packed_row_that_differs_is_shown(rounded, images):
    folder, predictions = rounded
    keys = ("objects", "tetX", "hypotheses", "all", "coverage_at_1_deg", "value")
    changed(folder / "tiny" / "mine.json.gz", *keys, value=0.875)
    refused = CliRunner().invoke(
        leaderboard, [str(folder), "--rescore", str(predictions), "--data", str(images.folder)]
    )
    assert "\n--- tiny/mine.json.gz, tetX\n" in str(refused.exception)
    found = rescore(read_leaderboard(folder), predictions, images.folder)
    assert [line[0] for line in found.diff] == ["-", "+"]


def test_the_account_names_the_predictions_of_the_scores(folder):
    sha256 = json.loads((folder / "tiny" / "far.json").read_text())["objects"]["tetX"]["predictions"]["sha256"]
    change_of("far.toml", "seed = 7", f'predictions_sha256 = "{sha256}"\nseed = 7')(folder / "tiny")
    read_leaderboard(folder)
    change_of("far.toml", sha256, "0" * 64)(folder / "tiny")
    with pytest.raises(ScoresError, match=rf"tetX\.predictions_sha256: the scores are of other .* '{sha256}'"):
        read_leaderboard(folder)
    change_of("far.toml", "0" * 64, "0x")(folder / "tiny")
    with pytest.raises(ScoresError, match="predictions_sha256: expected 64 hexadecimal digits, found '0x'"):
        read_leaderboard(folder)


def test_times_of_predicting_and_scoring_stand_on_the_page(folder):
    change_of("far.toml", "minutes = 3.25", "minutes = 3.25\npredict_minutes = 1.5")(folder / "tiny")
    change_of("far.toml", "hardware =", "score_minutes = 0.25\nhardware =")(folder / "tiny")
    page = page_of(folder)
    assert "| tetX | 7 | 3.2 |  | 1.5 |  |" in page
    assert "Scoring took 0.2 minutes in all." in page
    change_of("far.toml", "predict_minutes = 1.5", "predict_minutes = -1")(folder / "tiny")
    with pytest.raises(ScoresError, match="predict_minutes: expected a finite number, 0 or more, found -1"):
        read_leaderboard(folder)
