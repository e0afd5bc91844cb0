"""The command `publish`: what it takes, and what it refuses in one message."""

import re
import sys

import pytest
import yaml
from command_line import run, symsol


def test_bad_input_to_the_command_is_one_message(tmp_path):
    refused = symsol("publish", tmp_path / "nowhere", "--out", tmp_path / "out")
    assert refused.returncode == 1
    assert refused.stderr.startswith("Error: nothing was published:")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--title", ""),
        ("--title", "A {b"),
        ("--title", "}A{"),
        ("--title", b"A \xff"),
        ("--author", ""),
        ("--author", "B} C"),
        ("--version", ""),
        ("--version", "\u0661.0.0"),
        ("--date", ""),
        ("--date", "\u0662\u0660\u0662\u0666-01-31"),
        ("--url", ""),
        ("--url", "https://"),
        ("--url", b"https://x/\xff"),
        ("--url", "https://x/}{"),
        ("--url", "https://x/\\"),
        ("--url", "https://x/y z"),
        ("--url", "https://x/\u00e4"),
    ],
)
def test_the_command_refuses_what_hosts_and_bibtex_refuse(data, tmp_path, option, value):
    done = symsol("publish", data / "tetX", "--out", tmp_path / "out", option, value)
    assert (done.returncode, done.stdout) == (1, "")
    assert re.fullmatch(rf"Error: .*{option[2:]}.*: expected .*, found .*\n", done.stderr)
    assert not (tmp_path / "out").exists()


def test_the_command_takes_what_they_take(data, tmp_path):
    url = "https://example.org/~a/b?c=1&d=%7B#e_[1];f|g"
    given = ("--title", "{SO}(3), {{b}}", "--author", "Ä. {P}", "--author", "B", "--version", "10.0.1", "--url", url)
    done = symsol("publish", data / "tetX", "--out", tmp_path / "out", *given)
    assert done.returncode == 0, done.stderr
    entry = re.search(r"```bibtex\n(.*?)```", (tmp_path / "out" / "README.md").read_text(), flags=re.DOTALL)[1]
    for line in (
        "title = {{{SO}(3), {{b}}}},",
        "author = {{Ä. {P}} and {B}},",
        "version = {10.0.1},",
        f"url = {{{url}}},",
    ):
        assert f"  {line}\n" in entry
    assert yaml.safe_load((tmp_path / "out" / "CITATION.cff").read_text())["url"] == url


def test_without_pyarrow_the_command_says_what_to_install(data, tmp_path):
    blocked = "import sys; sys.modules['pyarrow'] = None; from symsol_annot_cli.main import main; main()"
    done = run(sys.executable, "-c", blocked, "publish", data / "tetX", "--out", tmp_path / "out")
    assert done.returncode == 1
    message = "publishing needs pyarrow, which is not installed: `pip install 'symsol-annot[publish]'`"
    assert done.stderr == f"Error: {message}\n"
