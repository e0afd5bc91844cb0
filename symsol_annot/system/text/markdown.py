"""Markdown's edge: words from files become text on a page, whatever markup they contain."""

import re
from collections.abc import Iterable, Sequence

_LIVE = frozenset("\\`*_{}[]<>|#&$!~^+@")  # may be markup anywhere in a line
_DOUBLED = frozenset("-=")  # is markup at a line's start, or beside another of its kind
_NUMBERED = re.compile(r"\d+[.)]")  # would begin a numbered list
_LONGEST_FENCE = re.compile(r"`{3,}")


def escaped(text: object) -> str:
    """Return words as Markdown that shows just these words, on one line: no markup, no HTML, no link, no equation.

    What could be markup becomes a numeric character reference, which code hosts and site builders alike show as the
    character, and which no extension of either takes for its own sign. Backslashes would not do: each dialect has a
    list of its own of what they escape. Line ends become blanks; what cannot be printed is left out.
    """
    words = ("".join(c for c in word if c.isprintable()) for word in str(text).split())
    line = " ".join(word for word in words if word)
    numbered = _NUMBERED.match(line)
    dot = numbered.end() - 1 if numbered else -1
    return "".join(f"&#{ord(c)};" if i == dot or _is_live(line, i) else c for i, c in enumerate(line))


def fenced(lines: str, language: str) -> str:
    """Return lines as a block of code, which nothing in them can end; what cannot be printed is left out."""
    kept = ["".join(c for c in line if c.isprintable() or c == "\t").rstrip() for line in lines.splitlines()]
    inside = "\n".join(kept)
    fence = "`" * max([3, *(len(found) + 1 for found in _LONGEST_FENCE.findall(inside))])
    return f"{fence}{language}\n{inside}\n{fence}"


def linked(words: object, target: str) -> str:
    """Return words as a link, whose target is no stranger's."""
    return f"[{escaped(words)}]({target})"


def tabled(rows: Iterable[Sequence[str]]) -> str:
    """Return rows of Markdown as a table, of which the first row is the head."""
    head, *body = rows
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *body))


def _is_live(line: str, i: int) -> bool:
    character = line[i]
    if character in _LIVE:
        return True
    if character == ":":  # one that ends a word, before a blank, is nothing but a colon
        return not (line[i - 1 : i].isalnum() and line[i + 1 : i + 2] == " ")
    return character in _DOUBLED and (i == 0 or character in (line[i - 1], line[i + 1 : i + 2]))
