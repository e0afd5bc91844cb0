"""How a bundle is to be cited: CITATION.cff."""

from pathlib import Path

import yaml

import symsol_annot

ROOT = Path(__file__).parents[2]


def test_the_citation_has_the_softwares_references(bundle):
    ours, softwares = (yaml.safe_load((folder / "CITATION.cff").read_text()) for folder in (bundle, ROOT))
    assert ours["type"] == "dataset"
    assert ours["license"] == "CC-BY-4.0"
    assert {"cff-version", "message", "title", "authors"} <= set(ours)
    assert [reference for reference in ours["references"] if reference["type"] != "software"] == softwares["references"]
    software = next(reference for reference in ours["references"] if reference["type"] == "software")
    assert software["version"] == symsol_annot.__version__
