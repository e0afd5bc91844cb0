"""The terminal's edge: all that the commands print goes through here, so that no file can speak to the terminal."""

import logging

import click

from symsol_annot.errors import printable


def say(text: object = "", *, err: bool = False) -> None:
    """Print text and a newline; control characters are shown as Python's escapes, line ends and tabs stay.

    Args:
        text: what is printed, as `str` gives it.
        err: on standard error.
    """
    click.echo(printable(str(text)), err=err)


class TerminalHandler(logging.Handler):
    """Prints what the library logs, on standard error."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record."""
        say(self.format(record), err=True)
