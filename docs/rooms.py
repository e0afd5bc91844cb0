"""The rooms of the code and who imports whom, from the code itself: .venv/bin/python docs/rooms.py.

It draws docs/images/rooms.svg, and writes the tables of docs/architecture.md: a room's purpose is the first sentence
of its `__init__.py`, a module's that of its own docstring.
"""

import ast
import re
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import TypeAlias

import grimp

ROOT = Path(__file__).resolve().parents[1]
DRAWING = ROOT / "docs" / "images" / "rooms.svg"
PAGE = ROOT / "docs" / "architecture.md"
BEGIN, END = "<!-- made by docs/rooms.py -->", "<!-- end of what docs/rooms.py made -->"
LIBRARY, COMMANDS = "symsol_annot", "symsol_annot_cli"
_BENCH = f"{LIBRARY}.bench"
_BOX, _GAP, _ROW, _EDGE = (132, 34), 28, 86, 24  # of the drawing, in pixels

Imports: TypeAlias = Mapping[str, frozenset[str]]
Stop: TypeAlias = str | tuple[str, str, int]  # a room, or where an arrow from one to another crosses a row


def main() -> None:
    """Draw, and write the tables."""
    DRAWING.write_text(drawing(imports_of_rooms()), encoding="utf-8")
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    PAGE.write_text(f"{before}{tables()}{rest.split(END)[1]}", encoding="utf-8")


def room_of(module: str) -> str | None:
    """Return the room that a module belongs to; None for the public names, the exceptions and the bare packages."""
    words = module.split(".")
    if words[0] == COMMANDS:
        return "cli"
    inside = words[2:] if module.startswith(f"{_BENCH}.") else words[1:]
    name = ".".join(words[: len(words) - len(inside) + 1]) if inside else ""
    return name.removeprefix(f"{LIBRARY}.") if name not in ("", _BENCH) and _is_package(name) else None


def imports_of_rooms() -> dict[str, frozenset[str]]:
    """Return for each room the rooms that its modules import, lower rooms first."""
    graph = grimp.build_graph(LIBRARY, COMMANDS, cache_dir=None)
    found: dict[str, set[str]] = {}
    for module in graph.modules:
        room = room_of(module)
        if room is not None:
            theirs = {room_of(other) for other in graph.find_modules_directly_imported_by(module)}
            found.setdefault(room, set()).update({other for other in theirs if other not in (None, room)})
    imports = {room: frozenset(others) for room, others in found.items()}
    return {room: imports[room] for room in sorted(imports, key=lambda room: (level(room, imports), room))}


def level(room: str, imports: Imports) -> int:
    """Return how many rooms lie under a room at most: 0 for one that imports none."""
    return max((1 + level(other, imports) for other in imports[room]), default=0)


def needed_arrows(imports: Imports) -> list[tuple[str, str]]:
    """Return the arrows, from the one who imports, that do not follow from others."""
    below = {room: _all_below(room, imports) for room in imports}
    return [
        (room, other)
        for room, others in imports.items()
        for other in sorted(others)
        if not any(other in below[between] for between in others)
    ]


def drawing(imports: Imports) -> str:
    """Return the rooms as an SVG: whoever stands higher imports; arrows that follow from others are left out."""
    arrows = [
        _Arrow(upper, lower, level(upper, imports), level(lower, imports)) for upper, lower in needed_arrows(imports)
    ]
    rows = _rows(imports, arrows)
    width = max(sum(_width(one) + _GAP for one in row) for row in rows) - _GAP + 2 * _EDGE
    height = len(rows) * _ROW - (_ROW - _BOX[1]) + 2 * _EDGE
    middle = {}
    for number, row in enumerate(rows):  # from the top
        x = (width - sum(_width(one) + _GAP for one in row) + _GAP) / 2
        for one in row:
            middle[one] = (x + _width(one) / 2, _EDGE + _BOX[1] / 2 + number * _ROW)
            x += _width(one) + _GAP
    parts = [_line([middle[stop] for stop in arrow.stops]) for arrow in arrows]
    parts += [_box(room, *middle[room]) for room in imports]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" width="{width:g}" '
        f'height="{height:g}" font-family="sans-serif" font-size="13">\n'
        "<title>The rooms of the code; an arrow leads from the one who imports to the imported</title>\n"
        '<defs><marker id="end" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        '<path d="M0 0 L8 4 L0 8 z" fill="#667788"/></marker></defs>\n'
        f'<rect width="{width:g}" height="{height:g}" fill="#ffffff"/>\n' + "\n".join(parts) + "\n</svg>\n"
    )


@dataclass(frozen=True)
class _Arrow:
    """An arrow between rooms, and the rows that it crosses between them."""

    upper: str
    lower: str
    upper_level: int
    lower_level: int

    @property
    def stops(self) -> list[Stop]:
        """What it leads through: its rooms, and a place of its own in each row between."""
        between = [(self.upper, self.lower, row) for row in range(self.upper_level - 1, self.lower_level, -1)]
        return [self.upper, *between, self.lower]


def _rows(imports: Imports, arrows: list[_Arrow]) -> list[list[Stop]]:
    """Return rooms and crossing arrows row by row, from the top, each under the middle of what leads to it."""
    rows: list[list[Stop]] = []
    for number in range(max(level(room, imports) for room in imports), -1, -1):
        row: list[Stop] = [room for room in imports if level(room, imports) == number]
        row += [stop for arrow in arrows for stop in arrow.stops if isinstance(stop, tuple) and stop[2] == number]
        above = rows[-1] if rows else []
        row.sort(key=lambda one: (_mean_place(one, above, arrows), str(one)))
        rows.append(row)
    return rows


def _mean_place(one: Stop, above: list[Stop], arrows: list[_Arrow]) -> float:
    """Return the mean of the places in the row above, from 0 to 1, that lead to a stop."""
    pairs = [pair for arrow in arrows for pair in pairwise(arrow.stops) if pair[1] == one]
    places = [(above.index(stop) + 0.5) / len(above) for stop, _ in pairs if stop in above]
    return sum(places) / len(places) if places else 0.5


def tables() -> str:
    """Return the page's part on the rooms: for each its purpose, whom it imports, and a line per module."""
    imports = imports_of_rooms()
    parts = [BEGIN, ""]
    for room, others in imports.items():
        folder = "cli" if room == "cli" else f"{LIBRARY}/{room.replace('.', '/')}"
        ordered = ", ".join(f"`{other}`" for other in imports if other in others)
        parts += [f"### {folder}", "", f"{purpose(ROOT / folder / '__init__.py')} Imports: {ordered or 'no room'}.", ""]
        parts += _table(ROOT / folder, sorted((ROOT / folder).rglob("*.py")))
    outside = [path for path in sorted((ROOT / LIBRARY).rglob("*.py")) if room_of(_module(path)) is None]
    parts += [
        f"### {LIBRARY} and {LIBRARY}/bench",
        "",
        "The exceptions, and the public names; no room imports those.",
        "",
    ]
    return "\n".join([*parts, *_table(ROOT / LIBRARY, outside), END])


def purpose(path: Path) -> str:
    """Return the first sentence of a module's docstring."""
    paragraph = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").split("\n\n")[0]
    return re.split(r"(?<!\beq\.)(?<!\beqs\.)(?<=\.)\s", " ".join(paragraph.split()), maxsplit=1)[0]


def _table(folder: Path, paths: list[Path]) -> list[str]:
    modules = [path for path in paths if path.name != "__init__.py"]
    rows = [f"| `{path.relative_to(folder)}` | {purpose(path).replace('|', '&#124;')} |" for path in modules]
    return ["| module | purpose |", "|---|---|", *rows, ""]


def _module(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def _is_package(name: str) -> bool:
    return (ROOT / name.replace(".", "/") / "__init__.py").is_file()


def _all_below(room: str, imports: Imports) -> frozenset[str]:
    return imports[room].union(*(_all_below(other, imports) for other in imports[room]))


def _width(stop: Stop) -> int:
    return _BOX[0] if isinstance(stop, str) else 0


def _box(room: str, x: float, y: float) -> str:
    width, height = _BOX
    return (
        f'<rect x="{x - width / 2:g}" y="{y - height / 2:g}" width="{width}" height="{height}" rx="5" fill="#eef3fa" '
        f'stroke="#4477aa"/><text x="{x:g}" y="{y + 4:g}" text-anchor="middle" fill="#222222">{escape(room)}</text>'
    )


def _line(places: list[tuple[float, float]]) -> str:
    """Return an arrow: straight between rows, upright where it crosses one."""
    half = _BOX[1] / 2
    points = [(places[0][0], places[0][1] + half)]
    for x, y in places[1:-1]:
        points += [(x, y - half), (x, y + half)]
    points.append((places[-1][0], places[-1][1] - half))
    drawn = " ".join(f"{x:g},{y:g}" for x, y in points)
    return f'<polyline points="{drawn}" stroke="#667788" fill="none" marker-end="url(#end)"/>'


if __name__ == "__main__":
    main()
