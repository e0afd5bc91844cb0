"""Croissant's description of a bundle: its validator accepts it, and reads every record by it."""

import hashlib
import json

import numpy as np
import pytest
import yaml
from bundles import SPLITS, assert_all_same, snapshot

import symsol_annot
from symsol_annot.publish.about import About
from symsol_annot.publish.publication import publish
from symsol_annot.publish.sets import sets_in


@pytest.mark.filterwarnings("ignore::DeprecationWarning:rdflib")
@pytest.mark.filterwarnings("ignore:.*is deprecated:DeprecationWarning")
def test_mlcroissant_validates_and_reads_every_record_offline(bundle, data, tmp_path, no_network):
    import mlcroissant

    croissant = mlcroissant.Dataset(jsonld=bundle / "croissant.json")
    assert not croissant.metadata.ctx.issues.errors
    assert [warning for warning in croissant.metadata.ctx.issues.warnings if "datePublished" not in warning] == []
    for name, split in SPLITS:
        records = list(croissant.records(f"{name}_{split}"))
        rows = [{field.partition("/")[2]: value for field, value in record.items()} for record in records]
        assert_all_same(rows, symsol_annot.load(data / name, split))
    groups = {record["symmetry_groups/set"]: record for record in croissant.records("symmetry_groups")}
    for name, split in SPLITS:
        group = np.array(groups[name.encode()]["symmetry_groups/symmetry_group"])
        assert group.tobytes() == symsol_annot.load(data / name, split).symmetry_group.tobytes()


@pytest.mark.filterwarnings("ignore:.*is deprecated:DeprecationWarning")
def test_with_a_date_and_a_url_croissant_has_nothing_to_say(data, tmp_path):
    import mlcroissant

    about = About("Tests", ("A. Person", 'The "Group"'), "2.1.0", "2026-01-31", "https://example.org/data")
    publish(sets_in(data / "cylO"), tmp_path / "bundle", about)
    croissant = mlcroissant.Dataset(jsonld=tmp_path / "bundle" / "croissant.json")
    assert not croissant.metadata.ctx.issues.errors | croissant.metadata.ctx.issues.warnings
    assert croissant.metadata.date_published.date().isoformat() == "2026-01-31"
    citation = yaml.safe_load((tmp_path / "bundle" / "CITATION.cff").read_text())
    assert citation["authors"] == [{"name": "A. Person"}, {"name": 'The "Group"'}]
    assert (citation["url"], citation["version"]) == ("https://example.org/data", "2.1.0")
    assert '{A. Person} and {The "Group"}' in (tmp_path / "bundle" / "README.md").read_text()


def test_croissant_lists_every_shard_and_parquet_file_as_it_is(bundle):
    distribution = json.loads((bundle / "croissant.json").read_text())["distribution"]
    listed = {item["contentUrl"]: item for item in distribution if item["@type"] == "cr:FileObject"}
    files = snapshot(bundle)
    assert set(listed) == {name for name in files if name.endswith((".h5", ".parquet"))}
    for name, item in listed.items():
        assert item["sha256"] == hashlib.sha256(files[name]).hexdigest()
        assert item["contentSize"] == f"{len(files[name])} B"
