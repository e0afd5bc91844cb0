"""The documents as a site: it builds without a fault, fetches nothing, and holds what it should."""

import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

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
