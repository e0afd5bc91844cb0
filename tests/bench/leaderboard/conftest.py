"""A leaderboard with one set and two results on it, and a copy of it to change."""

import shutil
from pathlib import Path

import pytest
from bench_sets import small_set
from made_boards import IMAGES, make_board


@pytest.fixture(scope="session")
def images(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("sets"), "tetX", IMAGES)


@pytest.fixture(scope="session")
def original(images, tmp_path_factory):
    return make_board(tmp_path_factory.mktemp("board"), images)


@pytest.fixture
def folder(original, tmp_path):
    return Path(shutil.copytree(original, tmp_path / "board"))
