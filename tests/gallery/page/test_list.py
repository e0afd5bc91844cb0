"""The gallery's list of images in a real Chromium: what it shows, how it sorts, what it does at a key."""

import numpy as np
import pytest
from gallery_browser import CHROMIUM, DRIVER
from gallery_pages import IMAGES

from symsol_annot import load
from symsol_annot.bench.scoring.scoring import score_file

pytestmark = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="needs Chromium: `python tools/gallery_browser.py` gets it"
)


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


def test_the_summary_counts_sets_and_averages_scores_of_the_images_shown(page, data, preds):
    scores = score_file(preds, data)
    values = scores.tracks["hypotheses"].per_image.values
    page.open(object="tetX", split="test")
    for stratum in ("shown", "hidden"):
        page.set("marking", stratum)
        chosen = scores.truth.strata[stratum]
        sizes, counts = np.unique(scores.truth.set_sizes[chosen], return_counts=True)
        span = str(sizes[0]) if len(sizes) == 1 else f"{sizes[0]} to {sizes[-1]}"
        assert page.text("summary-line") == f"Summary: symmetry sets of {span} rotations"
        rows = page.run(
            "[...document.querySelectorAll('#summary-parts table')]"
            ".map((t) => [...t.tBodies[0].rows].map((r) => [...r.cells].map((c) => c.textContent)))"
        )
        assert rows[0] == [[str(size), str(count)] for size, count in zip(sizes, counts, strict=True)]
        assert len(rows) == 2  # one run: there is none to compare it with
        name, mean = rows[1][0]
        assert name.startswith("recall mean error")
        assert float(mean) == pytest.approx(values["recall_mean_error_rad"][chosen].mean(), abs=1e-4)


def test_runs_are_compared_image_by_image_where_both_have_a_figure(page):
    page.open()
    rng = np.random.default_rng(8)
    first, second = np.where(rng.random((2, 60)) < 0.1, None, rng.integers(0, 4, (2, 60)))
    ids = list(range(5, 60))
    script = """(([a, b, better, ids]) => {
        const run = (values) => ({ better, values: values.map((v) => (v === null ? NaN : v)) });
        return SYMSOL.summary.against(run(a), run(b), ids); })(arguments[0])"""
    both = [i for i in ids if first[i] is not None and second[i] is not None]
    for better, sign in (("higher", 1), ("lower", -1)):
        differences = np.array([sign * (second[i] - first[i]) for i in both])
        found = page.run(script, [first.tolist(), second.tolist(), better, ids])
        assert found == {
            "better": (differences > 0).sum(),
            "worse": (differences < 0).sum(),
            "same": (differences == 0).sum(),
        }


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


def test_only_a_window_of_thumbnails_is_in_the_document(page):
    page.open(order="files", run="")
    first = page.options()
    assert len(first) < 80 < page.count()
    page.run("document.getElementById('window').scrollTo(0, 1e9)")
    page.wait_for("document.getElementById('option-156')")
    assert len(page.options()) < 80
    assert page.run("document.querySelector('#option-156').getAttribute('aria-setsize')") == str(page.count())


def test_the_address_opens_the_same_again(page, browser):
    page.open(object="tetX", marking="hidden", order="largest", image="2/0")
    before = (page.count(), page.options())
    address = browser.current_url
    browser.get("about:blank")
    browser.get(address)
    page.wait_for("document.body.dataset.ready")
    assert (page.count(), page.options()) == before
    assert page.open(object="nobody", image="77/1", order="?").count() == IMAGES + 7  # a wrong address is none
