"""The rows of a leaderboard's tables: seeds put together, sorted by what ranks, and marked; no word of Markdown."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.leaderboard.entries import Leaderboard, Reference, Result
from symsol_annot.bench.models.methods.hypotheses.recipe import HypothesisRecipe
from symsol_annot.bench.models.recipe import load_recipe
from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.bench.scoring.averages import Figure, PerImage, figures
from symsol_annot.bench.scoring.best import may_be_best
from symsol_annot.bench.scoring.metric import HIGHER, Metric, Place
from symsol_annot.bench.scoring.reports.scores_file import per_image_table
from symsol_annot.bench.scoring.scorers.table import SCORINGS, metric_of, metrics_shown

_THESIS_RECIPE = "wta-von-mises"  # whose M per object is the usual one: 30, and 75 of the icosahedron
COUNT = "M"


class Mark(Enum):
    """What a reader should know of a row, with its sign."""

    MAY_BE_BEST = "≈"
    MANY = "†"
    EXACT = "‡"


@dataclass(frozen=True, kw_only=True)
class Row:
    """A row of a table: a method with one or more seeds, or a reference.

    Attributes:
        name: which tells it from other rows, the same in all tables of a set.
        names: of its results, one per seed; of a reference its own.
        files: of their scores.
        title: the method.
        by: who sent it in; empty for a reference.
        facts: without which results cannot be compared, such as M, of lists of several lengths the longest one's.
        input_px: the side in pixels of the image that the network reads; None where not told.
        told: what it knew beyond images and rotations, in words.
        figures: metric to figure of all images, the mean over the seeds.
        seed_range: the least and largest of the ranked figure over the seeds; None for one seed.
        marks: what a reader should know of it.
        place: its rank, from 1; None for what does not rank.
    """

    name: str
    names: tuple[str, ...]
    files: tuple[str, ...]
    title: str
    by: str = ""
    facts: Mapping[str, Any]
    input_px: int | None = None
    told: tuple[str, ...] = ()
    figures: Mapping[str, Figure]
    seed_range: tuple[float, float] | None = None
    marks: frozenset[Mark] = frozenset()
    place: int | None = None

    @property
    def is_reference(self) -> bool:
        """Whether it was made from the labels, to compare results with."""
        return not self.by


@dataclass(frozen=True, kw_only=True)
class Table:
    """The rows about one object on one track.

    Attributes:
        object, track: their names.
        metrics: its columns of figures; the first is what ranks.
        rows: the ranked ones from the best on, those that are held back, references.
        usual_count: above which M is marked.
        is_tested: whether the rows that may be the best are marked.
    """

    object: str
    track: str
    metrics: tuple[Metric[Any], ...]
    rows: tuple[Row, ...]
    usual_count: int
    is_tested: bool

    @property
    def has_results(self) -> bool:
        """Whether there is a row that somebody sent in."""
        return any(not row.is_reference for row in self.rows)

    @property
    def ranked(self) -> tuple[Row, ...]:
        """The rows that have a rank."""
        return tuple(row for row in self.rows if row.place is not None)

    @property
    def marks(self) -> frozenset[Mark]:
        """The marks that its rows have."""
        return frozenset(mark for row in self.rows for mark in row.marks)


def tables_of(board: Leaderboard, folder: str) -> list[Table]:
    """Return the tables of a set, track by track and object by object."""
    results, references = board.results[folder], board.references[folder]
    objects = board.sets[folder].fingerprints
    found = (table_of(results, references, name, track) for track in TRACKS for name in objects)
    return [table for table in found if table is not None]


def table_of(results: Sequence[Result], references: Sequence[Reference], name: str, track: str) -> Table | None:
    """Return the table of an object on a track; None where nothing is known of it."""
    groups = [_Group.from_results(group, name, track) for group in _grouped(results, name, track)]
    beside = [_Group.from_results([row], name, track) for row in references if track in row.scores.get(name, {})]
    if not groups and not beside:
        return None
    sign = -1.0 if metric_of(track, TRACKS[track].ranked_by).better == HIGHER else 1.0
    usual_count = _usual_count(name)

    def cost(group: _Group) -> float:
        value = group.row.figures[TRACKS[track].ranked_by].value
        return math.inf if math.isnan(value) else sign * value

    def marked(group: _Group) -> Row:
        many = {Mark.MANY} if group.row.facts.get(COUNT, 0) > usual_count else set()
        return replace(group.row, marks=frozenset(many | ({Mark.EXACT} if group.is_exact else set())))

    ranking = sorted((group for group in groups if not group.is_exact), key=cost)
    held = sorted((group for group in groups if group.is_exact), key=cost)
    costs = [cost(group) for group in ranking]
    best, is_tested = _may_be_best(ranking, track)
    ranked = [
        replace(row, place=1 + costs.index(at), marks=row.marks | ({Mark.MAY_BE_BEST} if may else set()))
        for row, at, may in zip(map(marked, ranking), costs, best, strict=True)
    ]
    return Table(
        object=name,
        track=track,
        metrics=tuple(metric_of(track, name) for name in (TRACKS[track].ranked_by, *SCORINGS[track].beside_rank)),
        rows=(*ranked, *map(marked, held), *(group.row for group in sorted(beside, key=cost))),
        usual_count=usual_count,
        is_tested=is_tested,
    )


@dataclass(frozen=True, kw_only=True)
class _Group:
    """The results that make one row.

    Attributes:
        row: they make.
        values, weights: (N,) of what ranks, the mean over the seeds.
        is_exact: whether one of them is as exact as the labels.
    """

    row: Row
    values: npt.NDArray[np.float64]
    weights: npt.NDArray[np.float64]
    is_exact: bool

    @classmethod
    def from_results(cls, results: "Sequence[Result | Reference]", name: str, track: str) -> "_Group":
        """Put results together that differ in their seed alone."""
        entries = [result.scores[name] for result in results]
        first = results[0]
        tables = [_shown_of(per_image_table(dict(entry), track), track) for entry in entries]
        ranked_by = TRACKS[track].ranked_by
        mean = PerImage(
            tables[0].image_index,
            {m: np.mean([table.values[m] for table in tables], axis=0) for m in tables[0].values},
            {m: np.min([table.weights[m] for table in tables], axis=0) for m in tables[0].values},
        )
        each = [_figures_of(entry[track], track) for entry in entries]
        over_all = {"all": np.ones(len(mean.image_index), dtype=bool)}
        known = [found[ranked_by].value for found in each if not math.isnan(found[ranked_by].value)]
        row = Row(
            name=(first.account.method if isinstance(first, Result) else "") or first.name,
            names=tuple(result.name for result in results),
            files=tuple(result.scores_file for result in results),
            title=first.account.title if isinstance(first, Result) else first.method,
            by=first.account.by if isinstance(first, Result) else "",
            facts={fact: max(entry[track][fact] for entry in entries) for fact in SCORINGS[track].shown_facts},
            input_px=first.account.input_px if isinstance(first, Result) else None,
            told=tuple(_told(first)) if isinstance(first, Result) else (),
            figures=each[0] if len(each) == 1 else figures(mean, over_all)["all"],
            seed_range=(min(known), max(known)) if len(each) > 1 and known else None,
        )
        is_exact = any(SCORINGS[track].is_exact(entry[track]["all"]) for entry in entries)
        return cls(row=row, values=mean.values[ranked_by], weights=mean.weights[ranked_by], is_exact=is_exact)


def _grouped(results: Iterable[Result], name: str, track: str) -> list[list[Result]]:
    """Return the results that say something of an object on a track, those of one method together."""
    groups: dict[tuple[str, str], list[Result]] = {}
    for result in results:
        if track in result.scores.get(name, {}):
            method = result.account.method
            groups.setdefault(("method", method) if method else ("file", result.name), []).append(result)
    return list(groups.values())


def _told(result: Result) -> Iterator[str]:
    """Yield what a method knew beyond images and rotations."""
    if result.account.given_group:
        yield "group"
    if result.account.given_sets:
        yield "sets"


def figures_shown(track: str) -> list[str]:
    """Return the names of the metrics that the page shows of a track, what ranks first."""
    names = (TRACKS[track].ranked_by, *SCORINGS[track].beside_rank)
    return list(dict.fromkeys([*names, *(metric.name for metric in metrics_shown(track, Place.LEADERBOARD))]))


def _ranked_name(track: str, there: Iterable[str]) -> str:
    """Return the metric by which a result ranks; of hypotheses with weights, the one that counts them all alike."""
    instead = TRACKS[track].ranked_by_if_there
    return instead if instead in there else TRACKS[track].ranked_by


def _figures_of(scores: Mapping[str, Any], track: str) -> dict[str, Figure]:
    """Return the figures of all images that an entry of scores.json has; what ranks stands under one name."""
    found = scores["all"]
    names = {name: name for name in figures_shown(track)} | {TRACKS[track].ranked_by: _ranked_name(track, found)}
    return {name: _figure(found[there]) for name, there in names.items()}


def _shown_of(table: PerImage, track: str) -> PerImage:
    """Return each image's figures that the page shows; what ranks stands under one name."""
    names = {name: name for name in figures_shown(track)}
    names |= {TRACKS[track].ranked_by: _ranked_name(track, table.values)}
    values = {name: table.values[there] for name, there in names.items()}
    return PerImage(table.image_index, values, {name: table.weights[there] for name, there in names.items()})


def _figure(found: Mapping[str, Any]) -> Figure:
    value, low, high = (math.nan if found[end] is None else float(found[end]) for end in ("value", "low", "high"))
    return Figure(value, low, high, found["images"], found["undefined"])


def _may_be_best(ranking: "Sequence[_Group]", track: str) -> tuple[Sequence[bool], bool]:
    """Tell which rows may be the best, and whether that could be asked; one row alone is not asked about."""
    if len(ranking) > 1:
        better = metric_of(track, TRACKS[track].ranked_by).better
        found = may_be_best([(group.values, group.weights) for group in ranking], better)
        if found is not None:
            return (found.tolist() if found.sum() > 1 else [False] * len(ranking)), True
    return [False] * len(ranking), False


def _usual_count(name: str) -> int:
    """Return the M that the thesis's network has for an object."""
    recipe = load_recipe(_THESIS_RECIPE).for_object(name, has_marking=False)
    if not isinstance(recipe, HypothesisRecipe):
        raise TypeError(f"{_THESIS_RECIPE} is no recipe of hypotheses")
    return recipe.hypotheses
