"""Damage to bytes, to text and to JSON, whatever they are of."""

import contextlib
import json
import sys

import numpy as np

HUGE_FLOAT_TEXTS = ("1e308", "-1e308", "1e-320", "1e999", "nan", "inf", "-inf", "NaN", "Infinity")
_WORDS = (
    *HUGE_FLOAT_TEXTS,
    "0",
    "-1",
    "-0.0",
    "1.5",
    "true",
    "null",
    '""',
    "[]",
    "{}",
    "2147483648",
    "9223372036854775808",
    "1" + "0" * 30,
    "1" + "0" * 5000,
    "0x7f",
    "1_000",
    "1979-05-27T07:32:00Z",
    '"../../elsewhere"',
    '"/symsol-annot-attack"',
    '"\\u001b[2J\\u001b]0;owned\\u0007"',
    '"\\u202egnp.exe"',
    '"\\u0000"',
    '"' + "x" * 3000 + '"',
    "[" * 3000,
    "[" * 200 + "0.5" + "]" * 200,
    "'",
    '"""',
    "\\",
    "#",
    "\u2028",
)
ODD_VALUES = (
    None,
    True,
    False,
    0,
    -1,
    1,
    2,
    0.5,
    -0.0,
    float("nan"),
    float("inf"),
    -float("inf"),
    1e308,
    1e-320,
    2**31,
    2**53 + 1,
    2**62,
    2**63,
    2**64,
    10**30,
    10**400,
    "",
    " ",
    "x",
    ".",
    "..",
    "../../elsewhere",
    "/symsol-annot-attack",
    "tetX",
    "cylO",
    "train",
    "test",
    "all",
    "a/b",
    "a\\b",
    "nul\0l",
    "\ud800",
    "\x1b]0;owned\x07\x1b[2J\x1b[31m: whole and consistent",
    "\u202egnp.exe",
    "<script>alert(1)</script>",
    "::: x",
    "|a|b|\n|-|-|",
    "x" * 5000,
    [],
    {},
    [[]],
    [0.5],
    [None],
    {"a": 1},
    {"": {}},
)


def damage_text(text, rng):
    """Return text with one to three damages to its lines and words, and what was done."""
    changes = (replace_word, replace_word, replace_word, drop_line, double_line, swap_lines, add_line, flip_character)
    done = []
    for _ in range(rng.choice([1, 1, 2, 3])):
        change = changes[rng.integers(len(changes))]
        text = change(text, rng)
        done.append(change.__name__)
    return text, done


def replace_word(text, rng):
    """Put an odd value in place of one of a line's."""
    lines = text.split("\n")
    at = int(rng.integers(len(lines)))
    words = lines[at].split(" ")
    words[rng.integers(len(words))] = _WORDS[rng.integers(len(_WORDS))]
    lines[at] = " ".join(words)
    return "\n".join(lines)


def drop_line(text, rng):
    lines = text.split("\n")
    del lines[rng.integers(len(lines))]
    return "\n".join(lines)


def double_line(text, rng):
    lines = text.split("\n")
    at = int(rng.integers(len(lines)))
    return "\n".join([*lines[:at], lines[at], *lines[at:]])


def swap_lines(text, rng):
    lines = text.split("\n")
    a, b = rng.integers(len(lines), size=2)
    lines[a], lines[b] = lines[b], lines[a]
    return "\n".join(lines)


def add_line(text, rng):
    lines = text.split("\n")
    extra = ("[other]", "[marked]", "[objects.tetX]", "name = 1", "f 1 2 3", "f 1 1 1", "f -1 -2 -3", "v 1e300 0 0")
    odd = ("f 1 2 999999999", "v nan 0 0", "usemtl marking", "usemtl \x1b[31m", "x" * 10_000, "a.b.c.d = [" * 100)
    pool = (*extra, *odd)
    lines.insert(int(rng.integers(len(lines) + 1)), pool[rng.integers(len(pool))])
    return "\n".join(lines)


def flip_character(text, rng):
    at = int(rng.integers(max(1, len(text))))
    return text[:at] + chr(int(rng.integers(1, 0x250))) + text[at + 1 :]


def damage_json(document, rng, values=ODD_VALUES):
    """Change one to three places of a JSON document, each depth as likely as any other; return what was done."""
    done = []
    for _ in range(rng.choice([1, 1, 2, 3])):
        holder, key, path = _any_place(document, rng)
        if holder is None:
            continue
        kind = rng.random()
        if kind < 0.15:
            del holder[key]
            done.append(f"removed {path}")
        elif kind < 0.25 and isinstance(holder, dict):
            holder[str(rng.choice(["other", "", "../x", "\x1b[31m"]))] = holder.pop(key)
            done.append(f"renamed {path}")
        elif kind < 0.35 and isinstance(holder, list):
            holder.insert(key, holder[key])
            done.append(f"doubled {path}")
        elif kind < 0.4:
            holder[key] = _nested(int(rng.choice([50, 900, 3000])))
            done.append(f"nested {path}")
        elif kind < 0.5 and isinstance(holder[key], int | float):
            holder[key] = holder[key] + int(rng.choice([-1, 1, 100]))
            done.append(f"near {path}")
        else:
            holder[key] = values[rng.integers(len(values))]
            done.append(f"{path} = {str(holder[key])[:60]!r}")
    return done


@contextlib.contextmanager
def nested_deeply():
    """Let json go deeper than it may in what is attacked."""
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(30_000)
    try:
        yield
    finally:
        sys.setrecursionlimit(limit)


def json_bytes(document):
    """Return a document as JSON text, lone surrogates, NaN and deep nesting included."""
    with nested_deeply():
        return json.dumps(document, indent=1).encode(errors="surrogatepass") + b"\n"


def _any_place(document, rng):
    """Return a container, a key of it, and the path to that."""
    holder, path = document, ""
    while True:
        keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
        if not keys:
            return None, None, path
        key = keys[rng.integers(len(keys))]
        path = f"{path}/{key}"[:100]
        deeper = isinstance(holder[key], dict | list) and len(holder[key]) > 0
        if not deeper or rng.random() < 0.15:
            return holder, key, path
        holder = holder[key]


def _nested(depth):
    value = 0.5
    for _ in range(depth):
        value = [value]
    return value


def numbers_at(rng, size):
    """Return a number of so many bytes at which sizes and counts break."""
    limits = [0, 1, -1, 2 ** (8 * size - 1), 2 ** (8 * size - 1) - 1, 2**16, 2**31, int(rng.integers(2**16))]
    return (int(np.array(limits, dtype=object)[rng.integers(len(limits))]) % 2 ** (8 * size)).to_bytes(size, "little")
