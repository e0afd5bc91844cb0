"""docs/levels.py: densities scored on two grids, and the table of them."""

import json
import math

import levels
import pytest
from written_tables import END, beginning

from symsol_annot.errors import SettingsError

FIGURE = {"value": 5.25, "low": 5.0, "high": 5.5, "images": 4, "undefined": 0}
OF_LEVEL = {**dict.fromkeys(levels.FIGURES, FIGURE), "log_likelihood_ceiling": {**FIGURE, "low": 5.25, "high": 5.25}}


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A page and a file of results to write to."""
    (tmp_path / "page.md").write_text(f"before\n{beginning('levels.py')}\nold\n{END}\nafter\n")
    monkeypatch.setattr(levels, "PAGE", tmp_path / "page.md")
    monkeypatch.setattr(levels, "RESULTS", tmp_path / "levels.json")
    return tmp_path


def test_methods_that_a_folder_has_are_asked_at_each_level_and_predicted_once(tmp_path, monkeypatch):
    ran, run = [], levels.run
    monkeypatch.setattr(levels, "LEVELS", (0, 1))
    monkeypatch.setattr(levels, "IMAGES", 3)
    monkeypatch.setattr(levels, "run", lambda folder, words: (ran.append(words.split()[0]), run(folder, words)))
    levels.run(tmp_path, "render --object tetX --train 8 --test 1")
    del ran[:]
    found = levels.measured(tmp_path, "tetX", seed=0)
    assert ran == ["render", "retrieve", "score", "retrieve", "score"]
    assert list(found) == ["retrieval"]
    for level, cells in {"0": 72, "1": 576}.items():
        figures = found["retrieval"][level]
        assert figures["log_likelihood"]["images"] == 3
        most = math.log(cells) - math.log(math.pi**2)  # all of the mass in one cell
        assert figures["log_likelihood_at_gt"]["value"] < figures["log_likelihood_at_gt_ceiling"]["value"] <= most
    del ran[:]
    assert levels.measured(tmp_path, "tetX", seed=0) == found
    assert ran == ["render", "score", "score"]


def test_a_seed_that_was_not_trained_is_refused_before_anything_is_rendered(tmp_path):
    with pytest.raises(SettingsError, match=r"tet-mixture-seed-7: there is no such training; docs/baselines.py"):
        levels.measured(tmp_path, "tet", seed=7)
    assert list(tmp_path.iterdir()) == []


def test_what_was_asked_on_all_bodies_of_symsol_i_has_a_mean(kept):
    for number, name in enumerate(levels.SYMSOL_I):
        of_level = {figure: {**FIGURE, "value": 2.0 + number} for figure in levels.FIGURES}
        levels.keep(name, {"retrieval": {"4": of_level, "5": OF_LEVEL}, f"of-{name}": {"4": OF_LEVEL, "5": OF_LEVEL}})
        assert ("mean of" in levels.table()) == (name == levels.SYMSOL_I[-1])
    (mean,) = [line for line in levels.table().splitlines() if "mean of" in line]
    assert mean == "| mean of cone, cube, cyl, icosa, tet, retrieval | 4.000 | 4.000 | 4.000 | 5.250 | 5.250 | 5.250 |"


def test_an_objects_methods_stay_beside_one_another_and_the_table_has_both_levels(kept):
    levels.keep("tetX", {"retrieval": {"4": OF_LEVEL, "5": OF_LEVEL}})
    levels.keep("icosa", {"retrieval": {"4": OF_LEVEL, "5": OF_LEVEL}})
    levels.keep("tetX", {"mixture": {"4": OF_LEVEL, "5": OF_LEVEL}})
    levels.keep("tetX", {"mixture-seed-1": {"4": OF_LEVEL, "5": OF_LEVEL}})
    known = json.loads((kept / "levels.json").read_text())
    assert {name: list(methods) for name, methods in known.items()} == {
        "icosa": ["retrieval"],
        "tetX": ["retrieval", "mixture", "mixture-seed-1"],
    }
    levels.put_table(levels.PAGE, "levels.py", levels.table())
    lines = (kept / "page.md").read_text().splitlines()
    cell = "5.250<br>[5.000, 5.500]"
    of_level = f"{cell} | {cell} | 5.250"
    assert f"| tetX, mixture | {of_level} | {of_level} |" in lines
    assert f"| tetX, mixture, seed 1 | {of_level} | {of_level} |" in lines
    assert "old" not in lines
