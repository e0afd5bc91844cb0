"""Images whose sets fill a volume, on the gallery's page: the volume in both plots, in words, and in the summary."""

import numpy as np
import pytest
from gallery_browser import CHROMIUM, DRIVER, Page
from scipy.spatial.transform import Rotation

pytestmark = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="needs Chromium: `python tools/gallery_browser.py` gets it"
)


def dots_in_the_ball(page):
    """The rotations (n, 3, 3) that the ball shows of a volume."""
    traces = page.wait_for("document.getElementById('ball').data")
    found = [trace for trace in traces if "in the volume" in (trace.get("text") or [])]
    if not found:
        return np.zeros((0, 3, 3))
    columns = [found[0][axis] for axis in "xyz"]
    vectors = [list(column.values()) if isinstance(column, dict) else column for column in columns]
    return Rotation.from_rotvec(np.stack(vectors, axis=-1)).as_matrix()


def test_the_page_draws_a_volume_and_says_its_share(browser, balls):
    folder, images = balls
    labels, page = images.labels(), Page(browser, folder)
    filled, single = int(np.argmax(labels.volume >= 0)), int(np.argmax(labels.volume < 0))
    share = f"{labels.volumes[0].measure:.1%} of all rotations"
    page.open(image=f"0/{filled}")
    page.title(f"thing · test {filled}")
    dots = dots_in_the_ball(page)
    assert len(dots) == 500
    assert labels.volumes[0].distance(dots).max() < 1e-5
    assert page.run("document.querySelectorAll('#sphere circle.volume').length") == 500
    assert page.text("ball-volume") == f"; the set fills a volume, {share}"
    assert f"a volume, {share}" in page.text("facts")
    assert "from the volume" in page.text("legend")
    assert share in page.run("document.getElementById('ball-frame').getAttribute('aria-label')")
    page.open(image=f"0/{single}")
    page.title(f"thing · test {single}")
    assert len(dots_in_the_ball(page)) == 0
    assert page.run("document.querySelectorAll('#sphere circle.volume').length") == 0
    assert page.text("ball-volume") == ""
    assert f"{labels.symmetry_mask[single].sum()} of {labels.symmetry_mask.shape[1]} candidates" in page.text("facts")


def test_the_summary_counts_images_whose_sets_fill_a_volume(browser, balls):
    folder, images = balls
    labels, page = images.labels(), Page(browser, folder)
    filled = int((labels.volume >= 0).sum())
    page.open()
    assert f"{filled} image{' has a set' if filled == 1 else 's have sets'}" in page.text("summary-line")
    rows = page.run(
        "[...document.querySelector('#summary-parts tbody').rows].map((r) => [...r.cells].map((c) => c.textContent))"
    )
    sizes, counts = np.unique(labels.symmetry_mask.sum(axis=1)[labels.volume < 0], return_counts=True)
    assert rows[:-1] == [[str(size), str(count)] for size, count in zip(sizes, counts, strict=True)]
    assert rows[-1] == [f"{labels.volumes[0].measure:.1%} of all rotations", str(filled)]
    page.set("marking", "hidden")
    assert page.count() == filled
    assert page.text("summary-line").startswith(f"Summary: {filled} image")
