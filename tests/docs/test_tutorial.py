"""Pages that show a whole session: their commands and code run in order, and print what the page shows."""

import contextlib
import io
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r'^```(\w+)(?: title="(.+?)")?\n(.*?)^```$', flags=re.MULTILINE | re.DOTALL)
TOKEN = re.compile(r"\.\.\.|\d+(?:\.\d+)?(?:e-\d+)?|[^\W\d]+|[^\w\s]")


def agree(shown, printed):
    """Words are the same; numbers to 2%, for another Mesa may draw another pixel at an edge."""
    if shown[0].isdecimal() and printed[0].isdecimal():
        return float(printed) == pytest.approx(float(shown), rel=0.02, abs=0.002)
    return shown == printed


def shows(shown, printed):
    """Whether a page's output is what was printed; `...` stands for what is left out."""
    runs, run = [[]], 0
    for token in TOKEN.findall(shown):
        if token == "...":
            runs.append([])
        else:
            runs[-1].append(token)
    tokens = TOKEN.findall(printed)
    here = 0
    for number, run in enumerate(runs):
        last = len(tokens) - len(run)
        starts = range(here, last + 1)
        if number == 0:
            starts = starts[:1]
        if number == len(runs) - 1 and run:
            starts = [last] if last in starts else []
        found = (start for start in starts if all(map(agree, run, tokens[start:])))
        start = next(found, None)
        if start is None:
            return False
        here = start + len(run)
    return here == len(tokens) or not runs[-1]


def sh(text):
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    command = ["bash", "-euo", "pipefail", "-c", text]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{text}\n{done.stdout}{done.stderr}"
    return done.stdout


def python(text, names):
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(text, names)
    return printed.getvalue()


@pytest.mark.blender
@pytest.mark.parametrize("page", ["tutorial.md", "objects.md", "sealed.md"])
def test_a_page_runs_word_for_word_in_an_empty_folder(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = BLOCK.findall((ROOT / "docs" / page).read_text())
    assert {"sh", "text"} <= {language for language, _, _ in blocks}
    names, printed = {}, ""
    for language, title, text in blocks:
        if title:
            Path(title).parent.mkdir(parents=True, exist_ok=True)
            Path(title).write_text(text)
        elif language == "text":
            assert shows(text, printed), f"{page} shows\n{text}\nand this was printed:\n{printed}"
        else:
            printed = {"sh": sh, "python": lambda text: python(text, names)}[language](text)


@pytest.mark.parametrize(
    ("shown", "is_shown"),
    [
        ("29 of 60 (48.3%)\nall done", True),
        ("...\nall done", True),
        ("29 of ...", True),
        ("29 ... done", True),
        ("29 of 60 (48.4%)\nall done", True),
        ("29 of 60 (50.3%)\nall done", False),
        ("29 of 60", False),
        ("all done", False),
        ("... of 60 all done ... 29", False),
        ("29 on 60 (48.3%)\nall done", False),
    ],
)
def test_shown_output_is_what_was_printed_but_for_gaps(shown, is_shown):
    assert shows(shown, "29 of 60 (48.3%)\nall done\n") == is_shown
