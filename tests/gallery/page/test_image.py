"""An image in the gallery in a real Chromium: its scores, its set, what is drawn of it."""

import time

import numpy as np
import pytest
from gallery_browser import CHROMIUM, DRIVER
from gallery_pages import HOSTILE
from scipy.spatial.transform import Rotation

import symsol_annot
from symsol_annot import load
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.rotations.so3 import uniform_rotations

pytestmark = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="needs Chromium: `python tools/gallery_browser.py` gets it"
)


def test_scores_shown_of_an_image_are_the_scorers(page, data, preds):
    scores = score_file(preds, data).tracks["hypotheses"]
    page.open(image="2/17")
    page.title("tetX · test 17")
    rows = page.run(
        "[...document.querySelectorAll('#scores-body tr')].map((r) => [...r.cells].map((c) => c.innerText))"
    )
    error = scores.per_image.values["recall_mean_error_rad"][17]
    mean = scores.figures["all"]["recall_mean_error_rad"].value
    assert rows[0][1:3] == [f"{error:.4f}", f"{mean:.4f}"]
    assert rows[0][0].startswith("recall mean error")


def test_points_are_those_of_the_set_and_of_the_predictions(page, data):
    for place, name, i in (("2/5", "tetX", 5), ("0/1", "cylO", 1)):
        sample = load(data / name)[i]
        page.open(image=place)
        page.title(f"{name} · test {i}")
        traces = page.wait_for("document.getElementById('ball').data")
        found = next(trace for trace in traces if (trace.get("text") or [""])[0].startswith("member"))
        vectors = np.stack([np.array(list(values_of(found[axis]))) for axis in "xyz"], axis=-1)
        drawn = Rotation.from_rotvec(vectors).as_matrix()
        assert np.allclose(drawn, sample.symmetry_set, atol=1e-5)
        circles = page.run(
            "[...document.querySelectorAll('#sphere circle:not(.own)')].map((c) => [c.cx, c.cy]"
            ".map((v) => v.baseVal.value))"
        )
        assert np.allclose(circles, [on_the_map(R) for R in sample.symmetry_set], atol=0.02)
    predicted = page.open(image="2/5").wait_for("document.querySelectorAll('#sphere path.predicted').length")
    assert predicted == 4


def values_of(column):
    return column.values() if isinstance(column, dict) else column


def on_the_map(R):
    """The map of docs/gallery.md: longitude to the right from the camera's side, latitude up; by bisection."""
    axis = Rotation.from_euler("xyz", [0.2, 0.2, 0.2]).as_matrix()[:, 0]
    right, down, away = R @ axis
    longitude, latitude = np.arctan2(right, -away), np.arcsin(-down)
    low, high = -np.pi / 2, np.pi / 2
    for _ in range(60):
        theta = (low + high) / 2
        low, high = (theta, high) if 2 * theta + np.sin(2 * theta) < np.pi * np.sin(latitude) else (low, theta)
    return [100 * 2 * np.sqrt(2) / np.pi * longitude * np.cos(theta), -100 * np.sqrt(2) * np.sin(theta)]


def test_the_tilt_is_what_is_left_when_the_axis_is_turned_back(page):
    page.open()
    for R in uniform_rotations(8, np.random.default_rng(5)):
        x, y, z, w = Rotation.from_matrix(R).as_quat()
        seen = page.run("SYMSOL.rotations.direction(arguments[0])", [w, x, y, z])
        in_map = np.array([[0, 0, -1], [1, 0, 0], [0, -1, 0]]) @ R @ Rotation.from_euler("xyz", [0.2] * 3).as_matrix()
        again = Rotation.from_euler("ZYX", [seen["longitude"], -seen["latitude"], seen["tilt"]]).as_matrix()
        assert np.allclose(again, in_map, atol=1e-9)


def test_the_ball_stands_still_where_less_motion_is_wanted_until_t_is_pressed(page):
    page.open(image="2/0")
    page.title("tetX · test 0")
    assert page.run("matchMedia('(prefers-reduced-motion: reduce)').matches")
    before = page.camera()
    time.sleep(0.5)
    assert page.camera() == before
    page.run("document.getElementById('window').focus()")
    page.press("ArrowRight")
    page.wait_for("!document.getElementById('detail-title').textContent.endsWith('test 0')")
    page.wait_for("document.getElementById('detail').dataset.shown")
    assert page.camera() == before  # the view is kept from image to image
    assert page.text("turn") == "Turn"
    page.press("t")
    assert page.text("turn") == "Stop turning"
    page.wait_for(
        "document.getElementById('ball')._fullLayout.scene._scene.getCamera().eye.x !== arguments[0]", before["x"]
    )
    page.press("T")
    assert page.text("turn") == "Turn"


def test_what_the_page_gives_for_python_opens_the_image(page, data):
    page.open(image="2/5")
    page.title("tetX · test 5")
    code = page.run("document.querySelector('#facts code').textContent")
    sample = eval(code, {"symsol_annot": symsol_annot})
    assert np.array_equal(sample.image, load(data / "tetX")[5].image)
    assert sample.index == 5


def test_a_hostile_method_stays_text(page):
    page.open(image="2/0")
    page.title("tetX · test 0")
    assert HOSTILE in page.text("scores-title")
    assert HOSTILE in page.run("document.getElementById('run').selectedOptions[0].textContent")
    assert page.run("document.body.dataset.broken") is None
    assert page.run("document.querySelectorAll('img[src=x]').length") == 0


def test_what_was_drawn_again_is_shown_and_otherwise_said_why_not(page):
    page.open(redrawn="1", object="tetX", split="test")
    assert page.count() == 2
    page.wait_for("document.querySelectorAll('#drawings img').length > 1")
    page.wait_for("[...document.querySelectorAll('#drawings img')].every((image) => image.naturalWidth > 0)")
    page.run("document.querySelector('#drawings button').click()")
    assert page.run("document.querySelectorAll('#sphere .marked').length") == 1
    page.open(image="0/0")
    page.title("cylO · test 0")
    assert "the gallery was made with --redrawn 0" in page.text("drawings")
    page.open(image="2/0", find="0")
