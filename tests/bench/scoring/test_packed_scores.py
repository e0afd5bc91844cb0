"""scores.json.gz: the same bytes each time, read as plain ones, and nothing else that calls itself so."""

import gzip
import tracemalloc
import zlib

import pytest

from symsol_annot.bench.scoring.reports import report, scores_file
from symsol_annot.bench.scoring.reports.comparison import compare
from symsol_annot.bench.scoring.reports.scores_file import MAX_BYTES, read_scores, write_scores
from symsol_annot.errors import ScoresError


def test_what_is_written_packed_is_read_again(documents, tmp_path):
    plain, packed = tmp_path / "a.json", tmp_path / "a.json.gz"
    for path in (plain, packed):
        write_scores(path, documents[0])
    assert plain.read_text() == report.to_json(documents[0])
    assert gzip.decompress(packed.read_bytes()) == plain.read_bytes()
    assert packed.stat().st_size < plain.stat().st_size / 2
    assert read_scores(packed) == read_scores(plain) == documents[0]
    assert compare([packed, plain])


def test_packed_scores_are_the_same_bytes_each_time(documents, tmp_path):
    for name in ("a.json.gz", "other.json.gz"):
        write_scores(tmp_path / name, documents[0])
    first = (tmp_path / "a.json.gz").read_bytes()
    assert (tmp_path / "other.json.gz").read_bytes() == first
    assert first[4:8] == bytes(4)  # RFC 1952: no time; and no name, which the flags would tell
    assert first[3] == 0


def _packed(data):
    return gzip.compress(data, mtime=0)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is gzip that was cut short"),
        (b"{}", "is no gzip, or damaged"),
        (_packed(b"[" * 1000)[:-9], "is gzip that was cut short"),
        (_packed(b"{}")[:-8] + bytes(8), "is no gzip, or damaged"),
        (_packed(b"{}") + b"x", "is gzip with something behind its end"),
        (_packed(b"{}"), r"is no scores file"),
        (_packed(b"{"), "is no JSON"),
    ],
)
def test_what_is_no_packed_scores_file_is_refused(data, words, tmp_path):
    path = tmp_path / "a.json.gz"
    path.write_bytes(data)
    with pytest.raises(ScoresError, match=rf"a\.json\.gz: (cannot be read: )?{words}"):
        read_scores(path)


def test_a_bomb_is_given_up_at_the_bound(tmp_path, monkeypatch):
    path = tmp_path / "bomb.json.gz"
    path.write_bytes(_packed(bytes(2**22)))
    assert path.stat().st_size < 5000
    monkeypatch.setattr(scores_file, "MAX_BYTES", 2**20)
    with pytest.raises(ScoresError, match=r"bomb\.json\.gz: cannot be read: unpacks to more than the 1,048,576 bytes"):
        read_scores(path)
    assert MAX_BYTES == 2**26


def test_a_bomb_takes_no_more_memory_than_the_bound(tmp_path):
    """Ten times the bound, packed; all of it would be in memory if it were measured after it is unpacked."""
    path, packer = tmp_path / "bomb.json.gz", zlib.compressobj(wbits=31)
    first, again = (packer.compress(bytes(2**23)) + packer.flush(zlib.Z_FULL_FLUSH) for _ in range(2))
    path.write_bytes(first + 79 * again)  # what follows a full flush may be said again; the end is never reached
    tracemalloc.start()
    try:
        with pytest.raises(ScoresError, match="unpacks to more than the 67,108,864 bytes"):
            read_scores(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 4 * MAX_BYTES


@pytest.mark.parametrize("decimals", [5, 9])
def test_rounding_touches_figures_of_images_alone(decimals, pair):
    scores, _ = pair[0]
    exact, rounded = (report.to_document([scores], to)["objects"]["tetX"] for to in (None, decimals))
    assert rounded["per_image"].pop("decimals") == decimals
    of_images, of_rounded = exact.pop("per_image"), rounded.pop("per_image")
    assert rounded == exact
    assert of_rounded != of_images
    for track in ("hypotheses", "classifier", "density"):
        for metric, column in of_images[track].items():
            wanted = [None if value is None else round(value, decimals) for value in column]
            assert of_rounded[track][metric] == wanted
