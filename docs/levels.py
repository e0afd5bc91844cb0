"""Scores densities on the grids of levels 4 and 5: .venv/bin/python docs/levels.py FOLDER [--object NAME] [--seed S].

FOLDER is a working folder of docs/baselines.py: mixtures are asked that are in its `runs`, and retrieval searches the
train images of its `data`; of a seed other than 0 the mixture alone is asked. The images are the first 500 of each
published test split, rendered into FOLDER/first. docs/results/levels.json keeps the figures, by object, method and
level; the table of docs/symsol.md is written from that file. Whatever is predicted already is not predicted again.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from written_tables import put_table

from symsol_annot.bench.scoring.reports.scores_file import read_scores
from symsol_annot.errors import SettingsError, SymsolError
from symsol_annot.system.files import write_atomically

PROJECT = Path(__file__).resolve().parents[1]
RESULTS = PROJECT / "docs" / "results" / "levels.json"
PAGE = PROJECT / "docs" / "symsol.md"
LEVELS = (4, 5)
IMAGES = 500
SHOWN = {"at R_gt": "log_likelihood_at_gt", "on the set": "log_likelihood", "ceiling": "log_likelihood_ceiling"}
SYMSOL_I = ("cone", "cube", "cyl", "icosa", "tet")  # whose mean papers state
FIGURES = (*SHOWN.values(), "log_likelihood_at_gt_ceiling")


def main() -> None:
    """Predict and score at both levels, and write file and table after each object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--object", action="append", required=True, help="may be repeated")
    parser.add_argument("--seed", type=int, default=0, help="of the mixture's training")
    options = parser.parse_args()
    try:
        for name in options.object:
            keep(name, measured(options.folder.resolve(), name, options.seed))
            put_table(PAGE, Path(__file__).name, table())
    except SymsolError as error:
        sys.exit(f"Error: {error}")
    except subprocess.CalledProcessError as error:
        sys.exit(error.returncode)


def measured(folder: Path, name: str, seed: int) -> dict[str, dict[str, Any]]:
    """Return the figures of an object, by method and level; of methods that the folder has."""
    mixture, asking = f"mixture-seed-{seed}" if seed else "mixture", {}
    trained = folder / "runs" / f"{name}-{mixture}"
    if trained.is_dir():
        asking[mixture] = f"predict {trained}"
    elif seed:
        raise SettingsError(f"{trained}: there is no such training; docs/baselines.py mixture --seed {seed} makes it")
    if not seed:
        asking["retrieval"] = f"retrieve data/{name} --views {folder}/data/{name}"
    first = folder / "first"
    first.mkdir(exist_ok=True)
    run(first, f"render --object {name} --train 0 --test {IMAGES}")
    found: dict[str, dict[str, Any]] = {}
    for method, words in asking.items():
        for level in LEVELS:
            file = f"{name}-{method}-{level}"
            if not (first / f"{file}.h5").is_file():
                run(first, f"{words} --level {level} --out {file}.h5")
            run(first, f"score {file}.h5 --json {file}.json.gz")
            scores = read_scores(first / f"{file}.json.gz")["objects"][name]["density"]["all"]
            found.setdefault(method, {})[str(level)] = {figure: scores[figure] for figure in FIGURES}
    return found


def run(folder: Path, words: str) -> None:
    """Run a command of symsol-annot in a folder, and show it."""
    print("$ symsol-annot", words, flush=True)
    subprocess.run([Path(sys.executable).with_name("symsol-annot"), *words.split()], cwd=folder, check=True)


def keep(name: str, found: Mapping[str, Any]) -> None:
    """Put an object's figures into the file of results, beside those of other objects and methods."""
    known = known_results()
    known[name] = {**known.get(name, {}), **found}
    write_atomically(RESULTS, (json.dumps(dict(sorted(known.items())), indent=1) + "\n").encode())


def known_results() -> dict[str, dict[str, Any]]:
    """Return what the file of results has."""
    known: dict[str, dict[str, Any]] = json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}
    return known


def table() -> str:
    """Return the table of the results as Markdown, with the mean of what was asked on all bodies of SYMSOL I."""
    columns = [f"level {level}: {what}" for level in LEVELS for what in SHOWN]
    lines = [f"| | {' | '.join(columns)} |", "|---|" + "---|" * len(columns)]
    for name, by_method in known_results().items():
        for method, by_level in by_method.items():
            cells = [_cell(by_level[str(level)][figure]) for level in LEVELS for figure in SHOWN.values()]
            lines.append(f"| {name}, {_in_words(method)} | {' | '.join(cells)} |")
    of_bodies = [known_results().get(name, {}) for name in SYMSOL_I]
    for method in of_bodies[0]:
        if all(method in by_method for by_method in of_bodies):
            cells = [
                f"{sum(by_method[method][str(level)][figure]['value'] for by_method in of_bodies) / len(SYMSOL_I):.3f}"
                for level in LEVELS
                for figure in SHOWN.values()
            ]
            lines.append(f"| mean of {', '.join(SYMSOL_I)}, {_in_words(method)} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _in_words(method: str) -> str:
    return method.replace("-seed-", ", seed ")


def _cell(figure: Mapping[str, Any]) -> str:
    value, low, high = figure["value"], figure["low"], figure["high"]
    is_same = f"{low:.3f}" == f"{high:.3f}"  # a ceiling of an unmarked body
    return f"{value:.3f}" if is_same else f"{value:.3f}<br>[{low:.3f}, {high:.3f}]"


if __name__ == "__main__":
    main()
