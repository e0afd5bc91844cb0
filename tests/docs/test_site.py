"""The documents as a site: it builds without a fault, fetches nothing, and holds what it should."""

import inspect
import os
import re
import subprocess
import sys
import time
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import axe
import pytest
from gallery_browser import CHROMIUM, DRIVER, chromium

import symsol_annot
from symsol_annot import errors, grid
from symsol_annot import torch as torch_datasets
from symsol_annot.bench import losses, models, submission, views, weights
from symsol_annot.bench.scoring import metrics
from symsol_annot.rotations import so3

ROOT = Path(__file__).resolve().parents[2]


def build(config, site):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", str(config), "--site-dir", str(site)]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(command, env=quiet, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    done = build(ROOT / "mkdocs.yml", folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site):
    return {str(path.relative_to(site)): path.read_text() for path in site.rglob("*.html")}


def test_a_broken_link_or_heading_and_a_page_left_out_fail_the_build(tmp_path):
    docs = tmp_path / "docs"
    docs.mkdir()
    (docs / "index.md").write_text("# One\n\n[here](#one) [gone](gone.md) [nowhere](index.md#two) [abroad](/work.md)\n")
    (docs / "forgotten.md").write_text("# Forgotten\n")
    config = tmp_path / "mkdocs.yml"
    hooks = ROOT / "docs" / "site_hooks.py"
    config.write_text(
        f"INHERIT: {ROOT / 'mkdocs.yml'}\nhooks: [{hooks}]\nplugins: []\nnav: [index.md]\nextra_css: []\n"
    )
    done = build(config, tmp_path / "site")
    assert done.returncode == 1
    for fault in ("'gone.md'", "'index.md#two'", "'/work.md'", "forgotten.md"):
        assert fault in done.stderr, done.stderr
    assert "#one" not in done.stderr


def test_no_page_fetches_anything_from_elsewhere(site, pages):
    fetched = re.compile(
        r'<(?:link|script|img|iframe|source|video)\b[^>]*?\b(?:href|src|srcset)="?((?:https?:)?//[^">\s]+)'
    )
    assert {name: fetched.findall(text) for name, text in pages.items() if fetched.search(text)} == {}
    for style in site.rglob("*.css"):
        assert not re.search(r"(?:url\(|@import )['\"]?(?:https?:)?//", style.read_text()), style


def test_every_equation_is_drawn_without_a_script(pages):
    assert not [name for name, text in pages.items() if "arithmatex" in text]
    written = (ROOT / "docs" / "metrics.md").read_text()
    displayed, rest = (
        re.findall(r"\$\$.+?\$\$", written, re.DOTALL),
        re.sub(r"\$\$.+?\$\$", "", written, flags=re.DOTALL),
    )
    inline = re.findall(r"\$[^$]+\$", rest)
    math = re.findall(r"<math .+?</math>", pages["metrics.html"], re.DOTALL)
    assert len(math) == len(displayed) + len(inline) > 20
    assert sum('display="block"' in equation for equation in math) == len(displayed)
    assert not [equation for equation in math if "\\" in equation]  # a command that was not understood


def test_names_of_functions_stand_apart_from_what_is_beside_them(pages):
    space = '<mspace width="0.17em"></mspace>'
    logarithm_of_p = f"<mi>ln</mi>{space}<mi>p</mi>"
    exponential = f"<mi>R</mi>{space}<mi>exp</mi><mo"
    assert logarithm_of_p in pages["models.html"]
    assert exponential in pages["models.html"]


def test_every_picture_of_a_page_opens_in_its_own_size(site, pages):
    """On a phone, a figure with several panels is too small to read."""
    pictures = [
        (name, source, link)
        for name, text in pages.items()
        for link, source in re.findall(r'<a class="picture" href="([^"]+)"><img\b[^>]*?\bsrc="([^"]+)"', text)
    ]
    assert len(pictures) == sum(text.count("<img ") for text in pages.values()) > 20
    for name, source, link in pictures:
        assert link == source
        assert (site / name).parent.joinpath(link).is_file()


def test_the_api_pages_have_every_public_name(pages):
    there = {
        found for name, text in pages.items() if name.startswith("api/") for found in re.findall(r'id="([\w.]+)"', text)
    }
    public = {f"symsol_annot.{name}" for name in symsol_annot.__all__} - {"symsol_annot.__version__"}
    public -= {"symsol_annot.SymsolError"}  # stands with the other errors
    for module in (errors, so3, metrics):
        own = inspect.getmembers(module, lambda item: inspect.isclass(item) or inspect.isroutine(item))
        named = {item.__qualname__ for name, item in own if item.__module__ == module.__name__}
        public |= {f"{module.__name__}.{name}" for name in named if not name.startswith("_")}
    for module in (grid, torch_datasets, submission, models, losses, weights, views):
        public |= {f"{module.__name__}.{name}" for name in module.__all__ if callable(getattr(module, name))}
    assert len(public) > 50
    assert public <= there


def test_the_code_of_the_front_page_runs_as_it_is():
    names = {}
    exec(re.search(r"```python\n(.*?)```", (ROOT / "docs" / "index.md").read_text(), re.DOTALL)[1], names)
    assert names["sample"].image.shape == (224, 224, 3)
    assert names["sample"].symmetry_set.shape[1:] == (3, 3)


def test_the_pages_of_the_repositorys_root_are_in_the_site(pages):
    assert "Add a metric" in pages["contributing.html"]
    assert "Keep a Changelog" in pages["changelog.html"]
    assert 'href="contributing.html"' in pages["index.html"]


class Outline(HTMLParser):
    """What of a page is heard or found rather than seen: title, language, headings, pictures, width."""

    def __init__(self, text):
        super().__init__()
        self.levels, self.pictures, self.title, self.language, self.viewport = [], [], "", None, None
        self.in_title = False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        told = dict(attrs)
        if re.fullmatch("h[1-6]", tag):
            self.levels.append(int(tag[1]))
        elif tag == "img":
            self.pictures.append(told.get("alt", ""))
        elif tag == "html":
            self.language = told.get("lang")
        elif tag == "meta" and told.get("name") == "viewport":
            self.viewport = told["content"]
        self.in_title = tag == "title"

    def handle_data(self, data):
        self.title += data if self.in_title else ""


def test_every_page_has_a_title_of_its_own_headings_in_order_and_words_for_its_pictures(pages):
    outlines = {name: Outline(text) for name, text in pages.items() if name != "404.html"}
    titles = [outline.title.strip() for outline in outlines.values()]
    assert len(set(titles)) == len(titles)
    for name, outline in outlines.items():
        assert outline.language == "en", name
        assert "width=device-width" in outline.viewport, name
        assert outline.levels[0] == 1, name
        assert outline.levels.count(1) == 1, name
        assert all(level <= before + 1 for before, level in pairwise(outline.levels)), (name, outline.levels)
        assert all(len(words) > 10 for words in outline.pictures), (name, outline.pictures)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    if not (CHROMIUM and DRIVER):
        pytest.skip("needs Chromium: `python tools/gallery_browser.py` gets it")
    with chromium(tmp_path_factory.mktemp("chromium")) as driver:
        yield driver


def wait_for(driver, script):
    end = time.monotonic() + 20
    while not (found := driver.execute_script(f"return {script}")):
        assert time.monotonic() < end, f"never came true: {script}"
        time.sleep(0.02)
    return found


def test_the_search_finds_a_page_where_the_site_lies_on_a_disk(browser, site):
    browser.get((site / "api" / "index.html").as_uri())
    browser.execute_script("document.querySelector('input[name=query]').focus()")
    browser.switch_to.active_element.send_keys("covering radius")
    links = "[...document.querySelectorAll('.md-search-result__link')].map((a) => a.getAttribute('href'))"
    wait_for(browser, f"{links}.some((href) => href.includes('/metrics.html'))")
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []


def test_every_table_fits_a_desk_and_a_phone(browser, site, pages):
    """All tables of the site, in one page of it."""
    tables = [table for text in pages.values() for table in re.findall(r"<table>.*?</table>", text, re.DOTALL)]
    assert len(tables) > 60
    shell = re.sub(r"(<article\b[^>]*>).*(</article>)", "\\1TABLES\\2", pages["metrics.html"], flags=re.DOTALL)
    (site / "tables.html").write_text(shell.replace("TABLES", "".join(tables)))
    browser.get((site / "tables.html").as_uri())
    wait_for(browser, f"document.querySelectorAll('.md-typeset__scrollwrap').length === {len(tables)}")
    wide = "[...document.querySelectorAll('.md-typeset__scrollwrap')].filter((t) => t.scrollWidth > t.clientWidth)"
    for width in (1440, 390):
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 1000}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        assert browser.execute_script(f"return {wide}.map((t) => t.innerText.slice(0, 200))") == [], width
        assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


PAGES_FOR_AXE = ("bop", "index", "leaderboard", "metrics", "objects", "tutorial", "api/index", "api/torch")


@pytest.mark.parametrize(
    ("scheme", "theirs", "pages"),
    [("light", "default", PAGES_FOR_AXE), ("dark", "slate", ("leaderboard", "objects", "api/torch"))],
    ids=["light", "dark"],
)
def test_axe_finds_nothing_on_the_site(browser, site, scheme, theirs, pages):
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    browser.get((site / "bop.html").as_uri())
    browser.execute_script("localStorage.clear()")  # where the theme keeps the scheme
    for name in pages:
        browser.get((site / f"{name}.html").as_uri())
        wait_for(browser, f"document.body.dataset.mdColorScheme === '{theirs}'")
        assert axe.faults(browser) == [], name
