"""Help and completion: each command shows an example that it accepts, quickly, and shells complete what it takes."""

import os
import pty
import re
import shlex
import shutil
import subprocess
import sys
from importlib import resources
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from symsol_annot_cli.main import app

HEAVY = {"torch", "roma", "safetensors", "matplotlib", "bpy", "distributed", "pyarrow", "plotly"}


def commands_of(group, *path):
    """The words that name each command, without groups of commands."""
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from commands_of(command, *path, name)
        else:
            yield (*path, name)


COMMANDS = sorted(commands_of(app))


def help_of(*words):
    done = CliRunner().invoke(app, [*words, "--help"], prog_name="symsol-annot")
    assert done.exit_code == 0
    return done.output


def examples_in(text):
    """The command lines of a help's last block, as words, without what a shell does with their output."""
    _, _, block = text.partition("\n  Example:\n")
    lines = block.rstrip().splitlines()
    assert lines
    assert all(line.startswith("    ") for line in lines)
    return [shlex.split(command) for line in lines for command in re.findall(r"symsol-annot ([^>)]+)", line)]


@pytest.fixture
def mug(tmp_path, monkeypatch):
    """The folder in which an example's object of one's own lies."""
    shutil.copytree(str(resources.files("symsol_annot_assets") / "tetX"), tmp_path / "path/to/mug")
    monkeypatch.chdir(tmp_path)


def parse(command, words):
    """Parse a command line in full, as click does before it runs anything."""
    while isinstance(command, click.Group):
        command, *words = command.get_command(None, words[0]), *words[1:]
    command.make_context(command.name, list(words), parent=app.make_context("symsol-annot", ["info"]))


@pytest.mark.parametrize("command", [(), *COMMANDS], ids=" ".join)
def test_help_ends_with_examples_that_the_command_line_accepts(command, mug):
    """An option that is renamed, or a value out of range, fails."""
    examples = examples_in(help_of(*command))
    assert examples
    for words in examples:
        assert tuple(words[: len(command)]) == command
        parse(app, words)


def test_no_help_loads_an_extra():
    script = f"""
import sys
from symsol_annot_cli.main import app
for command in {[(), *COMMANDS]!r}:
    app.main([*command, "--help"], standalone_mode=False)
    print("loaded", *({HEAVY!r} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert re.findall("^loaded.*", done.stdout, flags=re.MULTILINE) == ["loaded"] * (1 + len(COMMANDS))


# Completion


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_each_shells_script_calls_the_program_by_its_name_and_variable(shell):
    script = CliRunner().invoke(app, ["completion", shell]).output
    assert f"_SYMSOL_ANNOT_COMPLETE={shell}_complete" in script
    assert re.search(r"^[^#]*\bcomp\w* .*symsol-annot", script, flags=re.MULTILINE)


def typed_into(shell, keys, folder):
    """Start an interactive shell in a folder at a terminal, type into it, and return what it shows."""
    ours, theirs = pty.openpty()
    environment = {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "TERM": "dumb",
        "PS1": "$ ",
    }
    process = subprocess.Popen(
        shell, stdin=theirs, stdout=theirs, stderr=theirs, cwd=folder, env=environment, start_new_session=True
    )
    os.close(theirs)
    os.write(ours, keys.encode())
    shown = b""
    try:
        while data := os.read(ours, 4096):
            shown += data
    except OSError:  # the terminal has no one at its other end any more
        pass
    os.close(ours)
    assert process.wait() == 0
    return shown.decode()


TO_START, TAB = "\x01", "\t"  # Ctrl-A
TYPED = {
    "symsol-annot compl": "symsol-annot completion",
    "symsol-annot render --eng": "symsol-annot render --engine",
    "symsol-annot render --engine cy": "symsol-annot render --engine cycles",
    "symsol-annot render --object te": "symsol-annot render --object tet",  # tet and tetX
    "symsol-annot render --object path/t": "symsol-annot render --object path/to/",
    "symsol-annot score pr": "symsol-annot score preds.h5",
}


@pytest.mark.skipif(not shutil.which("bash"), reason="no bash here")
def test_bash_completes_commands_options_values_objects_and_files(tmp_path):
    (tmp_path / "preds.h5").touch()
    (tmp_path / "path/to").mkdir(parents=True)
    lines = [f"{typed}{TAB}{TO_START}echo = \n" for typed in TYPED]  # completed, and then echoed instead of run
    keys = 'eval "$(symsol-annot completion bash)"\n' + "".join(lines) + "exit\n"
    shown = typed_into(["bash", "--norc", "--noprofile", "-i"], keys, tmp_path)
    completed = [line.strip() for line in re.findall(r"^= (.*)$", shown.replace("\r", ""), flags=re.MULTILINE)]
    assert completed == list(TYPED.values()), shown


@pytest.mark.skipif(not shutil.which("fish"), reason="no fish here")
def test_fish_completes_too(tmp_path):
    (tmp_path / "preds.h5").touch()
    typed = ["symsol-annot render --engine cy", "symsol-annot score pr"]
    script = "symsol-annot completion fish | source; " + "; ".join(f'complete -C "{line}"' for line in typed)
    environment = {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}", "HOME": str(tmp_path)}
    command = ["fish", "--no-config", "-c", script]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["cycles", "preds.h5"]
