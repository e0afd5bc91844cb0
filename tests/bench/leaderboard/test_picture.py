"""The picture of a leaderboard shows each method's figure and interval by object, the same on every machine."""

import dataclasses
import re
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import pytest
from click.testing import CliRunner
from made_boards import change_of
from symsol_annot_cli.leaderboard import leaderboard

from symsol_annot.bench.leaderboard import picture as drawing
from symsol_annot.bench.leaderboard.picture import PICTURES, Picture, Point, Series, draw, pictures_of
from symsol_annot.bench.leaderboard.results import read_leaderboard
from symsol_annot.errors import ScoresError

NAME = "leaderboard-tiny-hypotheses.svg"


def picture_of(folder, name=NAME):
    return next(picture for picture in pictures_of(read_leaderboard(folder)) if picture.name == name)


def test_a_picture_has_a_point_with_its_interval_for_each_row(folder):
    names = [picture.name for picture in pictures_of(read_leaderboard(folder))]
    assert names == [NAME, "leaderboard-tiny-classifier.svg"]
    made = picture_of(folder)
    assert (made.objects, [one.label for one in made.series]) == (
        ("tetX",),
        ["The near one (M = 1)", "The far one (M = 1)"],
    )
    for one in made.series:
        (point,) = one.points
        assert point.object == "tetX"
        assert point.low <= point.value <= point.high


def series(count, is_reference=False):
    points = tuple(Point(object=name, value=0.5, low=0.4, high=0.6) for name in ("a", "b"))
    return tuple(Series(label=f"m{i}", is_reference=is_reference, style=i, points=points) for i in range(count))


def test_points_do_not_cover_each_other_and_the_legend_is_off_the_data(monkeypatch, tmp_path):
    seen = []
    monkeypatch.setattr(drawing, "write_figure", lambda figure, *_, **__: seen.append(figure))
    draw(
        Picture(name="x.svg", axis="F", objects=("a", "b"), series=(*series(9), *series(4, is_reference=True))),
        tmp_path,
    )
    (figure,) = seen
    figure.canvas.draw()
    (axes,), (legend,) = figure.axes, figure.legends
    assert not axes.get_window_extent().overlaps(legend.get_window_extent())
    assert figure.bbox.containsx(legend.get_window_extent().x1)
    rows = [y for container in axes.containers for y in container[0].get_ydata()]
    assert len(set(rows)) == len(rows) == 26
    low, high = sorted(axes.get_ylim())
    assert all(low < row < high for row in rows)
    assert all(container[2] for container in axes.containers)  # lines of errors


def test_an_object_has_as_many_lines_as_methods(monkeypatch, tmp_path):
    seen = []
    monkeypatch.setattr(drawing, "write_figure", lambda figure, *_, **__: seen.append(figure))
    of_b = [dataclasses.replace(one, points=one.points[1:]) for one in series(6)]
    draw(Picture(name="x.svg", axis="F", objects=("a", "b"), series=(*of_b, *series(2, is_reference=True))), tmp_path)
    (axes,) = seen[0].axes
    lines = sorted(y for container in axes.containers for y in container[0].get_ydata())
    assert lines == [0, 1, *range(3, 11)]  # of a, whose references alone there are, and of b
    assert axes.get_ylim() == (11, -1)


def test_a_method_is_drawn_alike_in_all_pictures_of_a_set(folder):
    made = pictures_of(read_leaderboard(folder))
    by_method = [{one.label.partition(" (")[0]: one.style for one in picture.series} for picture in made]
    shared = by_method[0].keys() & by_method[1].keys()
    assert shared
    assert all(by_method[0][label] == by_method[1][label] for label in shared)
    assert all(len(set(styles.values())) == len(styles) for styles in by_method)


@pytest.mark.parametrize(
    ("counts", "told"), [((9, 9), "M = 9"), ((12, 9, 30), "M = 9, 12, 30"), ((9, 12, 24, 30), "M = 9 to 30")]
)
def test_many_numbers_of_hypotheses_are_told_by_the_least_and_the_most(counts, told):
    rows = {str(i): SimpleNamespace(title="A", facts={"M": count}, marks=()) for i, count in enumerate(counts)}
    assert drawing._label(rows) == f"A ({told})"


def test_no_two_of_sixty_methods_are_drawn_alike():
    styles = [(style["color"], style["marker"]) for style in map(drawing._style, series(60))]
    assert len(set(styles)) == 60


def test_the_same_figures_give_the_same_bytes_and_others_another_digest(folder, tmp_path):
    made = picture_of(folder)
    for place in ("one", "two"):
        (tmp_path / place).mkdir()
        draw(made, tmp_path / place)
    assert (tmp_path / "one" / NAME).read_bytes() == (tmp_path / "two" / NAME).read_bytes()
    change_of("far.toml", "The far one", "Another")(folder / "tiny")
    assert picture_of(folder).digest != made.digest


@pytest.mark.parametrize(("off", "is_same"), [(1e-15, True), (-1e-9, True), (2e-3, False)])
def test_a_figures_last_bits_are_another_machines_and_its_third_decimal_is_not(off, is_same, folder):
    made = picture_of(folder)
    moved = tuple(
        dataclasses.replace(
            series, points=tuple(dataclasses.replace(point, low=point.low + off) for point in series.points)
        )
        for series in made.series
    )
    assert (dataclasses.replace(made, series=moved).digest == made.digest) == is_same


@pytest.mark.parametrize("title", ["$x^2", "_hidden", "<b>&--></b>", "\\u001b[2J\\nx", "é" * 500])
def test_words_of_unknown_origin_are_words_in_the_picture(title, folder, tmp_path):
    change_of("far.toml", "The far one", title)(folder / "tiny")
    draw(picture_of(folder), tmp_path)
    root = ET.parse(tmp_path / NAME).getroot()
    assert root.tag.endswith("svg")
    assert not list(root.iter("{http://www.w3.org/2000/svg}script"))


def test_the_command_writes_the_pictures_that_the_page_shows_and_checks_them(folder, tmp_path):
    page, run = tmp_path / "page.md", CliRunner()
    assert run.invoke(leaderboard, [str(folder), "--out", str(page)]).exit_code == 0
    shown = re.findall(r"!\[[^]]*\]\(([^)]*)\)", page.read_text())
    assert shown == [f"{PICTURES}/{NAME}", f"{PICTURES}/leaderboard-tiny-classifier.svg"]
    assert all((tmp_path / path).is_file() for path in shown)
    check = [str(folder), "--out", str(page), "--check"]
    assert run.invoke(leaderboard, check).exit_code == 0
    old = (tmp_path / PICTURES / NAME).read_text()
    (tmp_path / PICTURES / NAME).write_text(old.replace(picture_of(folder).digest, "0" * 64))
    assert "shows other figures" in str(run.invoke(leaderboard, check).exception)
    (tmp_path / PICTURES / NAME).unlink()
    refused = run.invoke(leaderboard, check)
    assert isinstance(refused.exception, ScoresError)
    assert "is missing" in str(refused.exception)
