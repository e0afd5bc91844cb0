"""How the results were made, in Markdown: what each says of itself, and the figures that tables leave out."""

from collections.abc import Iterator, Sequence

from symsol_annot.bench.leaderboard.entries import Account, Leaderboard, Result
from symsol_annot.bench.leaderboard.rows import figures_shown
from symsol_annot.bench.scoring.reports.tables import cell
from symsol_annot.bench.scoring.scorers.table import SCORINGS, metric_of
from symsol_annot.system.text.markdown import escaped, fenced, linked, tabled


def accounts(board: Leaderboard, link: str) -> Iterator[str]:
    """Yield what each result says of itself, and those of its figures that the tables leave out."""
    for folder, results in board.results.items():
        for result in results:
            account = result.account
            yield f"### {escaped(f'{folder}/{result.name}')}"
            facts = [f"{escaped(account.title)}, by {escaped(account.by)}, {account.date}"]
            facts += [f"Hardware: {escaped(account.hardware)}"]
            facts += [f"Recipe: `{account.recipe}`"] if account.recipe else []
            facts += list(_knowledge(account))
            if account.score_minutes is not None:
                facts += [f"Scoring took {account.score_minutes:.1f} minutes in all"]
            facts += [escaped(account.notes).rstrip(".")] if account.notes else []
            files = (f"{result.name}.toml", result.scores_file)
            links = [linked(file, f"{link}/{folder}/{file}") for file in files]
            links += [linked("code", account.code)] if account.code.strip() else []
            yield f"{'. '.join(facts)}. Files: {', '.join(links)}"
            if account.commands:
                yield fenced("\n".join(account.commands), "sh")
            yield tabled(_training_rows(result))
            yield tabled(_digest_rows(result))
            for track in SCORINGS:
                if rows := list(_other_figures(result, track)):
                    yield tabled(rows)


def _knowledge(account: Account) -> Iterator[str]:
    """Yield what a method reads and was told, in sentences, as far as its account says so."""
    if account.input_px is not None:
        yield f"It reads {account.input_px}x{account.input_px} pixels"
    if account.given_group is not None:
        yield f"It was {'told' if account.given_group else 'not told'} the body's group"
    if account.given_sets is not None:
        yield f"It learnt from {'symmetry sets' if account.given_sets else 'one rotation per image'}"


def _training_rows(result: Result) -> Iterator[Sequence[str]]:
    trainings = result.account.objects
    with_predicting = any(training.predict_minutes is not None for training in trainings.values())
    yield ["", "seed", "training, minutes", "of processor time", *(["predicting, minutes"] * with_predicting), "start"]
    for name, training in trainings.items():
        minutes = [_minutes(training.minutes), _minutes(training.processor_minutes)]
        minutes += [_minutes(training.predict_minutes)] * with_predicting
        yield [escaped(name), str(training.seed), *minutes, escaped(training.first_stage)]


def _minutes(minutes: float | None) -> str:
    return "" if minutes is None else f"{minutes:.1f}"


def _digest_rows(result: Result) -> Iterator[Sequence[str]]:
    yield ["", "SHA-256 of the predictions"]
    for name in result.account.objects:
        yield [escaped(name), f"`{result.scores[name]['predictions']['sha256']}`"]


def _other_figures(result: Result, track: str) -> Iterator[Sequence[str]]:
    """Yield a table of the figures that the ranking tables leave out, with intervals; nothing where there are none."""
    names = figures_shown(track)[1 + len(SCORINGS[track].beside_rank) :]
    objects = [name for name in result.account.objects if track in result.scores[name]]
    if not names or not objects:
        return
    yield [track, *(metric_of(track, name).title + metric_of(track, name).arrow for name in names)]
    for name in objects:
        yield [escaped(name), *(cell(result.scores[name][track]["all"][metric]) for metric in names)]
