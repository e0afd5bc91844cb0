"""Tables of pages that a script writes, each between two comments."""

from pathlib import Path

END = "<!-- to here -->"


def beginning(script: str) -> str:
    """Return the comment before the table that a script of docs/ writes, by the script's name."""
    return f"<!-- written by docs/{script} -->"


def put_table(page: Path, script: str, table: str) -> None:
    """Put a script's table in its place on a page, or print it where the page has no place for it."""
    text, begin = page.read_text(), beginning(script)
    if begin not in text:
        print(f"{page} has no line {begin}; the table is:\n\n{table}")
        return
    before, rest = text.split(begin)
    after = rest.partition(END)[2]
    page.write_text(f"{before}{begin}\n{table}{END}{after}")
