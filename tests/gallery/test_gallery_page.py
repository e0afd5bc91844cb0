"""The gallery's page in a real Chromium, opened from disk: what it loads, shows, sorts, and does at a key."""

import json
import shutil
import time

import numpy as np
import pytest
from bench_sets import SIZE, small_set
from gallery_browser import CHROMIUM, DRIVER, Page, chromium
from made_sets import make_set
from numpy_renderer import NumpyRenderer
from scipy.spatial.transform import Rotation

import symsol_annot
from symsol_annot import load
from symsol_annot.bench.predictions import truth as truth_module
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.gallery.redrawn import Redrawer
from symsol_annot.gallery.runs import read_runs
from symsol_annot.gallery.sources import open_sources
from symsol_annot.gallery.writing import write_gallery
from symsol_annot.rotations.so3 import uniform_rotations

pytestmark = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="needs Chromium: `python tools/gallery_browser.py` gets it"
)
BARELY_PX = 3000  # scaled to this size 15 px, and tetX shows its marking with 5 or more


HOSTILE = "<img src=x onerror=\"document.body.dataset.broken='yes'\"><script>alert(1)</script>\u00e9 'mine'"
IMAGES = 150


@pytest.fixture(scope="module")
def barely_exists():
    """Images of 16 pixels in which the marking barely shows, which the real limit leaves none of."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(truth_module, "BARELY_PX", BARELY_PX)
        yield


@pytest.fixture(scope="module")
def data(tmp_path_factory, barely_exists):
    folder = tmp_path_factory.mktemp("place") / 'my "data"\\new'
    make_set(folder, train=4, test=IMAGES, size=SIZE, annotate="all")
    small_set(folder, "cylO", 3)
    return folder


@pytest.fixture(scope="module")
def preds(data, tmp_path_factory):
    path = tmp_path_factory.mktemp("preds") / "tetX.h5"
    hypotheses = uniform_rotations(4 * IMAGES, np.random.default_rng(3)).reshape(IMAGES, 4, 3, 3)
    write_hypotheses(path, load(data / "tetX"), hypotheses, method=HOSTILE)
    return path


@pytest.fixture(scope="module")
def gallery(data, preds, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "a gallery #1"

    def open_redrawer(source, runs):
        count = 2 if source.truth.object == "tetX" else 0
        return Redrawer(source, runs, count, open_renderer=lambda spec, camera, _: NumpyRenderer("tetX", camera.width))

    sources = open_sources(data, ("train", "test"))
    write_gallery(out, sources, read_runs([preds], data, sources), open_redrawer)
    return out


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with chromium(tmp_path_factory.mktemp("chromium")) as driver:
        yield driver


@pytest.fixture
def page(browser, gallery):
    return Page(browser, gallery)


def test_it_loads_without_an_error_and_asks_the_network_for_nothing(page, browser):
    browser.get_log("browser"), browser.get_log("performance")
    page.open()
    page.wait_for("document.querySelector('#ball canvas') && document.querySelector('#sphere circle')")
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    assert any(url.endswith("plotly.min.js") for url in asked)
    assert {url.split(":")[0] for url in asked} <= {"file", "data", "blob", "about"}
    assert "Network.webSocketCreated" not in {e["method"] for e in events}


ASKS = {
    "connect-src": "fetch('http://127.0.0.1:1').catch(() => {})",
    "img-src": "new Image().src = 'http://127.0.0.1:1/x'",
}


@pytest.mark.parametrize(("directive", "ask"), ASKS.items(), ids=ASKS)
def test_the_network_is_refused_by_the_pages_policy(page, directive, ask):
    page.open()
    refused = (
        "new Promise((resolve) => { setTimeout(resolve, 5000, 'nothing'); document.addEventListener("
        f"'securitypolicyviolation', (event) => resolve(event.effectiveDirective)); {ask}; }})"
    )
    assert page.run(refused) == directive


def test_filters_leave_as_many_images_as_the_library_counts(page, data, preds):
    truth = score_file(preds, data).truth
    page.open(object="tetX", split="test")
    assert page.count() == IMAGES
    for stratum in ("shown", "hidden", "barely"):
        page.set("marking", stratum)
        assert page.count() == truth.strata[stratum].sum()
    assert 0 < truth.strata["barely"].sum() < truth.strata["shown"].sum()
    page.set("marking", "")
    for least, most in ((3, 3), (6, 9), (4, ""), ("", 5), (10, "")):
        page.set("least", str(least))
        page.set("most", str(most))
        assert page.count() == ((truth.set_sizes >= (least or 0)) & (truth.set_sizes <= (most or 999))).sum()
    assert page.run("document.getElementById('nothing').checkVisibility()")
    page.run("document.getElementById('reset').click()")
    assert page.count() == IMAGES + 4 + 3
    page.set("split", "train")
    assert page.count() == 4
    page.run("document.getElementById('reset').click()")
    page.set("find", "cylo 2")
    assert page.options() == ["cylO 2"]
    page.set("find", "tetx hidden test")
    assert page.count() == truth.strata["hidden"].sum()


def test_worst_first_is_worst_first_by_the_scorer_and_undefined_last(page, data, preds):
    scores = score_file(preds, data).tracks["hypotheses"].per_image.values
    page.open()
    worst = np.argsort(-scores["recall_mean_error_rad"], kind="stable")
    shown = page.options()
    assert len(shown) > 20
    assert shown == [f"tetX {i}" for i in worst[: len(shown)]]
    page.set("order", "worst:f_measure_at_5_deg")  # here higher is better
    by_f = np.argsort(scores["f_measure_at_5_deg"], kind="stable")
    assert page.options() == [f"tetX {i}" for i in by_f[: len(page.options())]]
    page.set("order", "best:recall_mean_error_rad")
    assert page.options()[0] == f"tetX {np.argmin(scores['recall_mean_error_rad'])}"
    page.run("document.getElementById('window').focus()")
    page.press("End")
    assert page.options()[-7:] == ["cylO 0", "cylO 1", "cylO 2", "tetX 0", "tetX 1", "tetX 2", "tetX 3"]


def test_orders_by_the_set_and_by_the_marking_are_numpys(page, data):
    labels = load(data / "tetX").labels()
    sizes = labels.symmetry_mask.sum(axis=1)
    marking_px = np.where(labels.marking_visible, labels.marking_pixels, np.nan)
    page.open(object="tetX", split="test", run="")
    for order, column in (("largest", -sizes), ("smallest", sizes), ("least-marking", marking_px)):
        page.set("order", order)
        expected = [f"tetX {i}" for i in np.argsort(column, kind="stable")]  # NaN comes last
        shown = page.options()
        assert len(shown) > 20
        assert shown == expected[: len(shown)]
        page.run("document.getElementById('window').focus()")
        page.press("End")
        assert page.options()[-10:] == expected[-10:]


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


def test_the_keyboard_goes_everywhere(page):
    page.open(object="tetX", split="test", run="", order="files")
    page.run("document.getElementById('window').focus()")
    page.press("ArrowRight")
    page.title("tetX · test 1")
    active = page.run("document.getElementById('window').getAttribute('aria-activedescendant')")
    assert page.run("document.getElementById(arguments[0]).getAttribute('aria-selected')", active) == "true"
    page.press("ArrowDown")
    assert page.position() > 2
    page.press("ArrowUp", "ArrowLeft")
    page.title("tetX · test 0")
    page.press("End")
    page.title(f"tetX · test {IMAGES - 1}")
    page.press("Home")
    page.title("tetX · test 0")
    page.press("End", "Enter")
    assert page.focused() == "detail-title"
    page.press("ArrowLeft")
    page.title(f"tetX · test {IMAGES - 2}")
    page.press("Escape")
    assert page.focused() == "window"
    page.press("/")
    assert page.focused() == "find"
    page.press("12/")  # in a field it is a letter
    assert page.run("document.getElementById('find').value") == "12/"
    page.press("Escape")
    page.press("?")
    assert page.run("document.getElementById('keys').open")
    page.press("Escape")
    assert not page.run("document.getElementById('keys').open")


def test_the_page_keys_go_by_as_many_rows_as_are_seen(page):
    page.open(object="tetX", split="test", run="", order="files")
    page.run("document.getElementById('window').focus()")
    page.press("ArrowDown")
    columns = page.position()
    tops = "['0', arguments[0]].map((i) => document.getElementById(`option-${i}`).getBoundingClientRect().top)"
    first, second = page.run(tops, str(columns))
    seen = columns * int(page.run("document.getElementById('window').clientHeight") // (second - first))
    assert columns < seen < IMAGES / 2
    page.press("ArrowUp")
    positions = []
    for key in ("PageDown", "PageDown", "PageUp", "PageUp", "PageUp"):
        page.press(key)
        positions.append(page.position())
    assert positions == [seen, 2 * seen, seen, 0, 0]


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


def test_only_a_window_of_thumbnails_is_in_the_document(page):
    page.open(order="files", run="")
    first = page.options()
    assert len(first) < 80 < page.count()
    page.run("document.getElementById('window').scrollTo(0, 1e9)")
    page.wait_for("document.getElementById('option-156')")
    assert len(page.options()) < 80
    assert page.run("document.querySelector('#option-156').getAttribute('aria-setsize')") == str(page.count())


def test_what_was_drawn_again_is_shown_and_otherwise_said_why_not(page):
    page.open(redrawn="1", object="tetX", split="test")
    assert page.count() == 2
    page.wait_for("document.querySelectorAll('#drawings img').length > 1")
    page.wait_for("[...document.querySelectorAll('#drawings img')].every((image) => image.naturalWidth > 0)")
    page.run("document.querySelector('#drawings button').click()")
    assert page.run("document.querySelectorAll('#sphere .marked').length") == 1
    page.open(image="0/0")
    page.title("cylO · test 0")
    assert "none were asked for" in page.text("drawings")
    page.open(image="2/0", find="0")


def test_the_address_opens_the_same_again(page, browser):
    page.open(object="tetX", marking="hidden", order="largest", image="2/0")
    before = (page.count(), page.options())
    address = browser.current_url
    browser.get("about:blank")
    browser.get(address)
    page.wait_for("document.body.dataset.ready")
    assert (page.count(), page.options()) == before
    assert page.open(object="nobody", image="77/1", order="?").count() == IMAGES + 7  # a wrong address is none


def test_what_can_be_used_has_a_name_and_pictures_say_what_they_show(page, browser):
    page.open(image="2/3")
    page.title("tetX · test 3")
    nodes = browser.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    used = ("button", "combobox", "searchbox", "spinbutton", "checkbox", "listbox", "option", "image", "link", "dialog")
    found = [(n["role"]["value"], n["name"]["value"]) for n in nodes if not n["ignored"] and n["role"]["value"] in used]
    assert {"button", "combobox", "searchbox", "spinbutton", "checkbox", "listbox", "option", "image"} <= {
        r for r, _ in found
    }
    assert [role for role, name in found if not name.strip()] == []
    assert page.run("document.querySelectorAll('img:not([alt])').length") == 0
    assert page.run("document.getElementById('count').getAttribute('role')") == "status"
    assert "as rendered" in page.run("document.getElementById('image').alt")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_in_light_and_dark(page, browser, scheme):
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    page.open()
    assert page.run("document.documentElement.dataset.theme") == scheme
    colours = {
        name: page.run("SYMSOL.theme.colour(arguments[0])", name) for name in ("ink", "quiet", "prediction", "accent")
    }
    for ground in ("paper", "panel"):
        behind = page.run("SYMSOL.theme.colour(arguments[0])", ground)
        assert all(contrast(colour, behind) >= 4.5 for colour in colours.values())
    page.run("document.getElementById('theme').click()")  # automatic, then light, whatever the system says
    assert page.run("document.documentElement.dataset.theme") == "light"
    page.run("(() => { localStorage.clear(); SYMSOL.theme; })()")


def contrast(a, b):
    """WCAG's contrast of two colours like #1b1c1e."""

    def luminance(colour):
        levels = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        linear = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
        return linear @ [0.2126, 0.7152, 0.0722]

    dark, light = sorted([luminance(a), luminance(b)])
    return (light + 0.05) / (dark + 0.05)


def test_on_a_narrow_screen_an_image_opens_over_the_list_and_nothing_sticks_out(page, browser):
    size = {"width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        page.open(object="tetX", split="test", run="")
        assert not page.run("document.getElementById('detail').checkVisibility()")
        page.run("document.querySelector('.cell').click()")
        page.title("tetX · test 0")
        assert page.run("document.getElementById('detail').checkVisibility()")
        assert not page.run("document.getElementById('images').checkVisibility()")
        assert page.run("document.documentElement.scrollWidth") <= 390
        assert page.run("document.querySelector('main').scrollWidth") <= 390
        page.run("document.getElementById('close').click()")
        assert page.run("document.getElementById('images').checkVisibility()")
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_a_folder_that_lost_a_file_says_which(browser, gallery, tmp_path):
    lost = Page(browser, shutil.copytree(gallery, tmp_path / "lost"))
    (lost.folder / "sets" / "02-tetX-test" / "00000" / "labels.js").unlink()
    lost.open(image="2/0")
    lost.wait_for("document.getElementById('count').textContent.includes('cannot be')")
    assert "labels.js cannot be loaded" in lost.text("count")
    (lost.folder / "data" / "index.js").unlink()
    browser.get("about:blank")
    browser.get((lost.folder / "index.html").as_uri())
    lost.wait_for("document.getElementById('count').textContent.includes('cannot be')")
    assert "cannot be shown" in lost.text("count")
