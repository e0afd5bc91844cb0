"""The groups of real meshes: docs/results/groups.json and groups.md.

python tools/find_groups.py FOLDER... [--seconds 600]

Each FOLDER holds the unpacked files of one package of an index; its name is the package's. Every mesh in it that
`read_surface` can read is looked at, whatever its unit and place, at the default tolerance. A mesh of more triangles
than --most is left out, and said to be.
"""

import argparse
import json
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

from symsol_annot.errors import SymsolError
from symsol_annot.objects.finding.record import symmetries_to_json
from symsol_annot.objects.finding.symmetries import find_symmetries
from symsol_annot.objects.mesh_files.reading import ENDINGS, read_surface

INTRODUCTION = """\
Made by `tools/find_groups.py`. Lengths are parts of the mesh's radius; a symmetry may carry a point by {tolerance:g}.
`residual` is the largest distance of the points that were compared, over elements of the group; `bound` holds for all
points of the triangles that could be bounded, and for all elements, as products of a few; `next` is the residual of the
candidate that came nearest and failed; `larger` are groups of what is left without some faces."""
RESULTS = Path(__file__).parents[1] / "docs" / "results"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--seconds", type=float, default=600.0, help="Stop after these.")
    parser.add_argument("--most", type=int, default=100_000, help="Triangles.")
    parser.add_argument("--every", type=int, default=1, help="Look at every n-th mesh only.")
    parser.add_argument("--out", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    meshes = [
        (folder.name, path)
        for folder in arguments.folders
        for path in sorted(folder.rglob("*"))
        if path.suffix.lower().removeprefix(".") in ENDINGS
    ][:: arguments.every]
    rows, begun = [], time.monotonic()
    for package, path in meshes:
        if time.monotonic() - begun > arguments.seconds:
            break
        rows.append(row_of(package, path, arguments.most))
        print(rows[-1], file=sys.stderr, flush=True)
    document = {"found": len(meshes), "looked_at": len(rows), "tolerance": 1e-4, "meshes": rows}
    (arguments.out / "groups.json").write_text(json.dumps(document, indent=1) + "\n")
    (arguments.out / "groups.md").write_text(page(document))
    return 0


def row_of(package, path, most):
    """What was found about one mesh; the time is of the processor, without reading."""
    row = {"package": package, "mesh": path.name}
    try:
        surface = read_surface(path)
        row["triangles"] = len(surface.triangles)
        if len(surface.triangles) > most:
            return row | {"refused": f"more than {most:,} triangles"}
        begun = time.process_time()
        found = find_symmetries(surface)
        row["seconds"] = round(time.process_time() - begun, 3)
    except SymsolError as error:
        return row | {"refused": str(error).removeprefix(f"{path}: ")}
    record = symmetries_to_json(found)
    shape = record["shape"]
    return row | {
        "group": shape["group"],
        "residual": shape["residual"],
        "bound": shape["bound"],
        "triangles_not_bounded": shape["triangles_not_bounded"],
        "next_failed": shape["next_failed"] and shape["next_failed"]["residual"],
        "round": record["round"],
        "larger": [{"group": one["group"], "but_for": one["but_for"]} for one in record["larger"]],
    }


def page(document):
    """The table, for docs/results/groups.md."""
    rows = document["meshes"]
    done = [row for row in rows if "group" in row]
    seconds = np.array([row["seconds"] for row in done])
    counts = Counter(row["group"] for row in done).most_common()
    failed = [row for row in rows if "refused" in row]
    summary = (
        f"{document['looked_at']} of {document['found']} meshes were looked at, {len(failed)} refused. Processor time: "
        f"median {np.median(seconds):.2f} s, largest {seconds.max():.2f} s, {np.count_nonzero(seconds > 5)} above 5 s."
    )
    lines = [
        *("# The groups of real meshes", "", INTRODUCTION.format(**document), "", summary, ""),
        f"Groups: {', '.join(f'{name} {count}' for name, count in counts)}.",
        "",
        "| mesh | triangles | group | residual | bound | next | larger |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        name = f"`{row['package']}/{row['mesh']}`"
        if "refused" in row:
            lines.append(f"| {name} | {row.get('triangles', '')} | refused: {row['refused']} |||||")
            continue
        lines.append(
            f"| {name} | {row['triangles']} | {row['group']} | {row['residual']:.1e} | {row['bound']:.1e} "
            f"| {'' if row['next_failed'] is None else format(row['next_failed'], '.1e')} "
            f"| {'; '.join(one['group'] + ' but for ' + one['but_for'] for one in row['larger'])} |"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
