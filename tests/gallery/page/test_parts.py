"""A set of an object with parts on the gallery's page: parts by name, their colours, and filters by what is in view."""

from functools import partial

import pytest
from gallery_browser import CHROMIUM, DRIVER, Page
from made_sets import threads
from mesh_renderer import MeshRenderer
from parted_objects import TOML, mug

from symsol_annot import load
from symsol_annot.gallery.redrawn import Redrawer
from symsol_annot.gallery.sources import open_sources
from symsol_annot.gallery.writing import write_gallery
from symsol_annot.generation.generate import generate
from symsol_annot.objects.spec import read_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.plan import SetPlan

pytestmark = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="needs Chromium: `python tools/gallery_browser.py` gets it"
)


@pytest.fixture(scope="module")
def parted(tmp_path_factory):
    """A gallery of a prism with a handle, and its set."""
    place = tmp_path_factory.mktemp("parted")
    (place / "object.toml").write_text(TOML)
    (place / "mesh.obj").write_text(mug())
    plan = SetPlan(read_object(place), {"test": 8}, 0, Camera.filling(16), RenderSettings(), "test")
    generate(plan, place / "data" / "mug", threads(partial(MeshRenderer, plan.spec, plan.camera)))
    write_gallery(place / "page", open_sources(place / "data"), [], lambda source, runs: Redrawer(source, runs, 0))
    return place / "page", load(place / "data" / "mug", "test")


def test_the_page_names_the_parts_and_finds_images_by_them(browser, parted):
    folder, images = parted
    page = Page(browser, folder)
    page.open(image="0/0")
    page.title("mug · test 0")
    parts = "[...document.querySelectorAll('#segmentation-caption .part')].map((one) => one.textContent)"
    assert page.run(parts) == ["\u25a0 body", "\u25a0 handle"]
    shown = images.labels().marking_visible
    assert f"handle {'shown' if shown[0] else 'hidden'}, " in page.text("facts")
    for wanted, count in (("seen:handle", shown.sum()), ("unseen:handle", (~shown).sum())):
        page.set("marking", wanted)
        page.wait_for(f"document.getElementById('count').innerText.startsWith('{count} ')")
    page.set("marking", "")
    page.set("find", "handle")
    page.wait_for(f"document.getElementById('count').innerText.startsWith('{shown.sum()} ')")
