"""Fixtures of archives: a small set, its archive beside its digest, and a host that has both."""

import hashlib

import pytest
from archive_host import Host
from made_sets import make_set

from symsol_annot.archives.archive import archive_blocks
from symsol_annot.archives.digest_files import to_digest_line


@pytest.fixture(scope="session")
def packed_set(tmp_path_factory):
    """A small set of 3 + 1 shards; not to be written to."""
    return make_set(tmp_path_factory.mktemp("packed") / "data", "tetX", train=5, test=40)


@pytest.fixture(scope="session")
def archive(packed_set, tmp_path_factory):
    """The set's archive, with its digest beside it; not to be written to."""
    path = tmp_path_factory.mktemp("archives") / "tetX.tar"
    path.write_bytes(b"".join(archive_blocks(packed_set, "tetX")))
    path.with_name("tetX.tar.sha256").write_bytes(to_digest_line(sha256_of(path.read_bytes()), "tetX.tar"))
    return path


@pytest.fixture
def host(archive, monkeypatch):
    """A host of the archive, on this machine."""
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    files = {f"/{path.name}": path.read_bytes() for path in archive.parent.iterdir()}
    with Host(files) as running:
        yield running


def sha256_of(data):
    return hashlib.sha256(data).hexdigest()
