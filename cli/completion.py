"""`symsol-annot completion`: complete commands, options and their values in the shell."""

import click
from click.shell_completion import get_completion_class
from symsol_annot_cli.parameters import example
from symsol_annot_cli.terminal import say

_PROGRAM, _VARIABLE = "symsol-annot", "_SYMSOL_ANNOT_COMPLETE"  # the one that click derives from the program's name


@click.command(
    epilog=example(
        "echo 'eval \"$(symsol-annot completion bash)\"' >> ~/.bashrc",
        "echo 'eval \"$(symsol-annot completion zsh)\"' >> ~/.zshrc",
        "symsol-annot completion fish > ~/.config/fish/completions/symsol-annot.fish",
    )
)
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print the script that lets a shell complete commands, options and their values.

    Bash needs version 4.4 or newer.
    """
    completer = get_completion_class(shell)
    if completer is None:
        raise click.UsageError(f"this version of click completes nothing in {shell}; update click")
    script = completer(context.find_root().command, {}, _PROGRAM, _VARIABLE)
    say(script.source_template % script.source_vars())  # source() would ask this machine's bash for its version
