"""Fixtures of publishing: small sets and their bundle, which are made once per session, and no network."""

import os

import pytest
from bench_sets import small_set
from made_sets import make_set

from symsol_annot.publish.about import About
from symsol_annot.publish.publication import publish
from symsol_annot.publish.sets import sets_in

pytest.register_assert_rewrite("bundles")  # its claims say what they compared, as those of tests do
os.environ |= {"HF_HUB_OFFLINE": "1", "HF_DATASETS_DISABLE_PROGRESS_BARS": "1"}  # read when they are imported


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """Sets of a marked body, an unmarked one, and one with a split without symmetry sets; not to be written to."""
    folder = tmp_path_factory.mktemp("sets") / "data"
    small_set(folder, "cylO", images=4)
    make_set(folder, "tet", train=110, test=0, annotate="all")  # a shard of more than a row group
    make_set(folder, "tetX", train=5, test=40)
    return folder


@pytest.fixture(scope="session")
def bundle(data, tmp_path_factory):
    """The bundle of these sets; not to be written to."""
    out = tmp_path_factory.mktemp("published") / "bundle"
    publish(sets_in(data), out, About())
    return out


@pytest.fixture
def no_network(monkeypatch):
    """A machine on which asking the network fails the test."""

    def refuse(*_):
        raise AssertionError("the network was asked")

    monkeypatch.setattr("socket.socket.connect", refuse)
    monkeypatch.setattr("socket.getaddrinfo", refuse)
