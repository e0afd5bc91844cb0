"""Scores files that cannot be compared or were edited: refused by name, with all that is wrong."""

import copy
import json
import os
import random
import re

import pytest
from compared_scores import COMPARED_IMAGES

from symsol_annot.bench.scoring.reports.comparison import compare
from symsol_annot.bench.scoring.scorers.table import SCORINGS
from symsol_annot.errors import ScoresError

FUZZED = int(os.environ.get("SYMSOL_FUZZED_SCORES", "120"))


def changed(document, path, value):
    """A copy of a document with another value at a path; None of a name deletes it."""
    document = copy.deepcopy(document)
    *way, last = path.split(".")
    place = document
    for name in way:
        place = place[name]
    if value is Ellipsis:
        del place[last]
    else:
        place[last] = value
    return document


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (
            "objects.tetX.fingerprint",
            "0" * 64,
            "is about fingerprint '.*', .*1.json about '0000.*only scores on the same",
        ),
        ("objects.tetX.split", "train", "is about split 'test', .* about 'train'"),
        ("objects.tetX.per_image.set_size", [3] * COMPARED_IMAGES, "differ in per_image.set_size of the same images"),
        ("objects.tetX.per_image.strata", {}, "differ in per_image.strata of the same images"),
        ("objects", {}, "no object in common"),
        ("objects.tetX.hypotheses", ..., "no track in common"),
    ],
)
def test_scores_on_other_images_are_refused(documents, save, path, value, words):
    with pytest.raises(ScoresError, match=words):
        compare(save(documents[0], changed(documents[1], path, value)))


def test_scores_of_another_object_are_refused(documents, save):
    other = changed(documents[1], "objects", {"cylO": documents[1]["objects"]["tetX"]})
    with pytest.raises(ScoresError, match="no object in common"):
        compare(save(documents[0], other))


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("format", "another", "is no scores file .*`score --json` writes one"),
        ("format", ..., "is no scores file"),
        ("format_version", 2, "of format version 2, newer than 1, .* update it"),
        ("format_version", "x" * 10_000, "found 'x{90,100}"),
        ("method", ..., "'method' is no name"),
        ("method", "\x1b[2J", "'method' is no name"),  # which would clear a terminal
        ("objects", [], "'objects' is no table"),
        ("objects", {"a\nb": {}}, "'objects' has 'a\\\\nb', which is no object's name"),
        ("objects.tetX", 1, "objects.tetX has no 'per_image'"),
        ("objects.tetX.images", True, "objects.tetX.images is no count"),
        ("objects.tetX.images", 0, "objects.tetX.images is no count"),
        ("objects.tetX.images", 10**30, "objects.tetX.images is no count"),
        ("objects.tetX.images", 41, "objects.tetX.per_image.set_size is no list of 41 counts"),
        ("objects.tetX.per_image.set_size", [0] * COMPARED_IMAGES, "set_size is no list of 40 counts"),
        ("objects.tetX.per_image.strata.shown", [-1], "strata is no table"),
        ("objects.tetX.per_image.strata.shown", [10**30], "strata is no table"),
        ("objects.tetX.per_image.strata.shown", [3, 3], "strata is no table"),
        ("objects.tetX.per_image.strata.shown", [[3]], "strata is no table"),
        ("objects.tetX.per_image.decimals", 4, "per_image.decimals: expected 5 to 12"),
        ("objects.tetX.per_image.decimals", 13, "per_image.decimals: expected 5 to 12"),
        ("objects.tetX.per_image.hypotheses", ..., "per_image.hypotheses is missing"),
        (
            "objects.tetX.per_image.hypotheses.coverage_at_5_deg",
            ["0.5"] * COMPARED_IMAGES,
            "coverage_at_5_deg is no list of 40",
        ),
        (
            "objects.tetX.per_image.hypotheses.coverage_at_5_deg",
            [1e300] * COMPARED_IMAGES,
            "coverage_at_5_deg is no list of 40",
        ),
        ("objects.tetX.per_image.hypotheses.coverage_at_5_deg", [0.5], "coverage_at_5_deg is no list of 40 figures"),
        ("objects.tetX.hypotheses.all.coverage_at_5_deg", ..., "hypotheses.all.coverage_at_5_deg has no value"),
        ("objects.tetX.hypotheses.all.coverage_at_5_deg.value", "1", "hypotheses.all.coverage_at_5_deg has no value"),
        ("objects.tetX.hypotheses.shown", ..., "hypotheses.shown is no table of figures"),
        ("objects.tetX.hypotheses.name", 3, r"hypotheses.name: expected 'hypotheses \(M = 1\)', found 3"),
        ("objects.tetX.hypotheses.warnings", ["\n"], "hypotheses.warnings is no list of texts"),
        ("objects.tetX.hypotheses.notes", "none", "hypotheses.notes is no list of texts"),
        ("objects.tetX.hypotheses.M", 2, r"hypotheses.name: expected 'hypotheses \(M = 2\)'"),
        ("objects.tetX.hypotheses.M", "1", "hypotheses.M: expected 1 to 10000 hypotheses per image, found '1'"),
        ("objects.tetX.hypotheses.M", ..., "hypotheses.M: expected 1 to 10000 hypotheses per image, found None"),
        ("objects.tetX.hypotheses", [], "hypotheses is no table of figures"),
        ("objects.tetX.split", "validation", "split: expected one of train, test, found 'validation'"),
        ("objects.tetX.fingerprint", "\x1b[2J", "fingerprint is no text"),
        ("objects", {"../tetX": {}}, "'objects' has '../tetX', which is no object's name"),
        ("method", "x" * 201, "'method' is no name: expected 1 to 200 printable characters"),
        ("method", "  ", "'method' is no name"),
        ("objects.tetX.hypotheses.all.coverage_at_1_deg", [0.1], "all.coverage_at_1_deg has no value"),  # of plots
        ("objects.tetX.hypotheses.all.coverage_at_1_deg.low", {}, "all.coverage_at_1_deg has no value"),
        ("objects.tetX.hypotheses.all.coverage_at_1_deg.images", -1, "all.coverage_at_1_deg has no value"),
        ("objects.tetX.hypotheses.all.coverage_at_1_deg.value", 10**400, "all.coverage_at_1_deg has no value"),
    ],
)
def test_an_edited_file_is_refused_with_its_name_and_what_is_wrong(documents, save, path, value, words):
    paths = save(documents[0], changed(documents[1], path, value))
    with pytest.raises(ScoresError, match=f"(?s){re.escape(str(paths[1]))}.*{words}"):
        compare(paths)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is no JSON"),
        (b"\x89HDF\r\n\x1a\n", "is no JSON"),
        (b"\xff\xfe", "is no JSON"),
        (b"[]", "is no scores file"),
        (b"null", "is no scores file"),
        (b'"symsol-annot scores"', "is no scores file"),
        (b"[" * 100_000, "is no JSON"),
        (b"1" * 10_000, "is no JSON"),
        (b'{"format": "symsol-annot scores"', "is no JSON"),
        (b'{"format": 1, "format": 1}', "is no JSON: the key 'format' stands in one table more than once"),
        (b"[" * 300_000, "is no scores file: it has more than 262,144 lists and tables"),
        (b" " * (2**26 + 1), "cannot be read: is larger than the 67,108,864 bytes"),
    ],
)
def test_what_is_no_scores_file_is_refused(documents, save, tmp_path, data, words):
    (tmp_path / "foreign.json").write_bytes(data)
    with pytest.raises(ScoresError, match=f"foreign.json: {words}"):
        compare([*save(documents[0]), tmp_path / "foreign.json"])


@pytest.mark.parametrize("word", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_numbers_that_are_none_are_refused(documents, save, word):
    (path,) = save(documents[0])
    value = json.dumps(documents[0]["objects"]["tetX"]["per_image"]["hypotheses"]["coverage_at_5_deg"][0])
    text = path.read_text()
    start = text.index('"coverage_at_5_deg": [')
    path.write_text(text[:start] + text[start:].replace(value, word, 1))
    with pytest.raises(ScoresError, match="coverage_at_5_deg is no list of 40 figures"):
        compare([path, path])


def test_what_is_no_file_is_refused_and_not_waited_for(documents, save, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for name, words in (("nowhere", "cannot be read: No such file"), (".", "is a folder"), ("pipe", "no regular file")):
        with pytest.raises(ScoresError, match=words):
            compare([*save(documents[0]), tmp_path / name])


def test_all_faults_of_a_file_are_said_at_once_up_to_ten(documents, save):
    broken = changed(documents[0], "method", 7)
    broken["objects"]["tetX"]["hypotheses"]["warnings"] = None
    with pytest.raises(ScoresError) as refused:
        compare(save(broken, documents[1]))
    assert str(refused.value).splitlines()[1:] == [
        "  - 'method' is no name: expected 1 to 200 printable characters, not all of them spaces",
        "  - objects.tetX.hypotheses.warnings is no list of texts",
    ]
    broken["objects"]["tetX"]["hypotheses"]["all"] = broken["objects"]["tetX"]["density"]["all"] = {}
    with pytest.raises(ScoresError) as refused:
        compare(save(broken, documents[1]))
    assert len(str(refused.value).splitlines()) == 1 + 10


def places(value, way=()):
    """Every path in a document."""
    if isinstance(value, dict):
        children = value.items()
    elif isinstance(value, list):
        children = enumerate(value)
    else:
        return
    for name, child in children:
        yield (*way, name)
        yield from places(child, (*way, name))


STRANGE = [
    None,
    True,
    -1,
    0,
    1,
    10**30,
    1e300,
    -0.5,
    "",
    "\x1b[2J",
    "0.5",
    [],
    [1],
    [[]],
    {},
    {"value": 1},
    [None] * 40,
]


def test_a_fuzzed_file_ends_in_a_table_or_in_a_message(documents, tmp_path):
    """Names deleted, types swapped and values moved about, at places of every depth."""
    rng = random.Random(5)
    good = tmp_path / "good.json"
    good.write_text(json.dumps(documents[0]))
    by_depth = {}
    for way in places(documents[0]):
        by_depth.setdefault(len(way), []).append(way)
    ended = {"table": 0, "message": 0}
    for _ in range(FUZZED):
        fuzzed = copy.deepcopy(documents[0])
        for _ in range(rng.choice([1, 1, 2, 5])):
            damage(fuzzed, rng.choice(by_depth[rng.choice(list(by_depth))]), rng)
        path = tmp_path / "fuzzed.json"
        path.write_text(json.dumps(fuzzed))
        try:
            said, end = compare(rng.sample([good, path], 2)), "table"
        except ScoresError as error:
            said, end = str(error), "message"
        assert said.replace("\n", "").isprintable()
        ended[end] += 1
    assert min(ended.values()) > FUZZED // 20, ended


def damage(document, way, rng):
    *before, last = way
    place = document
    try:
        for name in before:
            place = place[name]
        kind = rng.randrange(4)
        if kind == 0:
            del place[last]
        elif kind == 1:
            place[last] = copy.deepcopy(rng.choice(STRANGE))
        elif kind == 2:
            place[last] = copy.deepcopy(rng.choice(list(document.values())))
        elif isinstance(place, dict):
            place[rng.choice(["x", "\n", "all", "shown", *SCORINGS])] = place.pop(last)
    except (KeyError, IndexError, TypeError):  # what was there is damaged already
        pass


def test_scores_of_more_images_than_anybody_has_are_refused_before_work_is_done_on_them(documents, save):
    count = 300_000
    entry = {
        **documents[0]["objects"]["tetX"],
        "images": count,
        "per_image": {"set_size": [1] * count, "strata": {}, "hypotheses": {"coverage_at_5_deg": [0] * count}},
    }
    entry = {name: value for name, value in entry.items() if name not in ("classifier", "density")}
    document = {**documents[0], "objects": {"a": entry, "b": entry}}
    (path,) = save(document)
    with pytest.raises(ScoresError, match="about 600,000 images together; at most 400,000 are read"):
        compare([path, path])
