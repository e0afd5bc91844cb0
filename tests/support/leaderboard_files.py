"""Leaderboards of a small set, changed as tests need them, and the page that is made of one."""

import json
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FILES = ROOT / "docs" / "results" / "leaderboard"
IMAGES = 24


def edited(path, *keys, value):
    """Change one value of a JSON file."""
    document = json.loads(path.read_text())
    table = document
    for key in keys[:-1]:
        table = table[key]
    table[keys[-1]] = value
    path.write_text(json.dumps(document))


def change_of(file, before, after):
    def change(place):
        text = (place / file).read_text()
        assert before in text
        (place / file).write_text(text.replace(before, after))

    return change
