"""What is said while a set is made: a bar for people, lines of JSON for machines, and a summary at the end."""

import json
import sys
import time
from collections import Counter
from collections.abc import Callable
from types import TracebackType
from typing import Any, Protocol, Self

from symsol_annot_cli.parameters import progress_bar
from symsol_annot_cli.terminal import say
from tqdm import tqdm

from symsol_annot.errors import printable
from symsol_annot.generation.events import (
    Event,
    ForeignShardsFound,
    ImagesMade,
    ObjectChecked,
    ShardBegunAgain,
    ShardFinished,
    Started,
    WorkersGone,
)

LOG_FORMATS = ("text", "json")
_JSON_SECONDS = 1.0  # between two lines of progress


class Tally:
    """What has happened so far."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._started_at = clock()
        self.images = self.shards = 0  # of the whole set
        self.images_done = self.shards_done = 0
        self._images_there = 0
        self.failures: list[ShardBegunAgain] = []

    def add(self, event: Event) -> None:
        """Count an event."""
        match event:
            case Started():
                self._started_at = self._clock()
                self.images, self.shards = event.images, event.shards
                self.images_done = self._images_there = event.images_there
                self.shards_done = event.shards_there
            case ImagesMade():
                self.images_done += event.images
            case ShardFinished():
                self.shards_done += 1
            case ShardBegunAgain():
                self.failures.append(event)

    @property
    def images_per_second(self) -> float:
        """The rate since the start; 0 before the first image."""
        return (self.images_done - self._images_there) / max(self._clock() - self._started_at, 1e-9)

    @property
    def seconds_left(self) -> float | None:
        """The time left at that rate; None before the first image."""
        rate = self.images_per_second
        return (self.images - self.images_done) / rate if rate > 0 else None

    def failures_by_worker(self) -> Counter[str]:
        """Return how many shards each worker failed at."""
        return Counter(failure.worker or "a worker" for failure in self.failures)


class Reporter(Protocol):
    """Shows events; as a context manager, for as long as the work lasts."""

    tally: Tally

    def __call__(self, event: Event) -> None:
        """Show one event."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class TextReporter:
    """A bar with images, shards, rate and time left, where standard error is a terminal; failures as lines anywhere."""

    def __init__(self, title: str) -> None:
        self.tally = Tally()
        self._title = title
        self._bar: tqdm[None] | None = None  # until the work is known

    def __call__(self, event: Event) -> None:
        """Show one event."""
        self.tally.add(event)
        match event:
            case Started():
                self._bar = progress_bar(event.images, "image", done=event.images_there)
                self._bar.set_description(self._title)
            case ImagesMade() if self._bar:
                self._bar.update(event.images)
            case ShardBegunAgain():
                self._say(f"{event.shard}: begun again after failure {event.attempt}. {event.reason}")
            case ObjectChecked():
                self._say(f"the mesh has {event.group}, within {event.residual:.2g} of its radius")
                self._say("\n".join(event.notes))
            case ForeignShardsFound():
                self._say(f"left alone, for they are no shards of this set: {', '.join(event.files)}")
            case WorkersGone():
                self._say("There is no worker at the moment; waiting for one. Ctrl-C keeps the finished shards.")
        if self._bar:
            failed = f", {len(self.tally.failures)} begun again" if self.tally.failures else ""
            self._bar.set_postfix_str(f"{self.tally.shards_done}/{self.tally.shards} shards{failed}", refresh=False)

    def _say(self, line: str) -> None:
        tqdm.write(printable(line), file=sys.stderr)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar:
            self._bar.close()


class JsonReporter:
    """A line of JSON on standard error for each event, and one line of progress per second."""

    def __init__(self) -> None:
        self.tally = Tally()
        self._shown_at = 0.0

    def __call__(self, event: Event) -> None:
        """Show one event."""
        self.tally.add(event)
        match event:
            case ImagesMade():
                if time.monotonic() - self._shown_at < _JSON_SECONDS:
                    return
                self._shown_at = time.monotonic()
                self._line("progress")
            case Started():
                self._line("started", images_there=event.images_there, shards_there=event.shards_there)
            case ObjectChecked():
                about = {"group": event.group, "residual": event.residual, "notes": event.notes}
                self._line("object_checked", **about)
            case ForeignShardsFound():
                self._line("strangers_found", files=event.files)
            case ShardFinished():
                self._line("shard_finished", shard=event.shard, worker=event.worker)
            case ShardBegunAgain():
                about = {"shard": event.shard, "worker": event.worker, "attempt": event.attempt}
                self._line("shard_begun_again", **about, reason=event.reason)
            case WorkersGone():
                self._line("workers_gone")

    def _line(self, event: str, **about: Any) -> None:
        tally = self.tally
        left = tally.seconds_left
        line = {
            "time": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "event": event,
            **about,
            "images_done": tally.images_done,
            "images": tally.images,
            "shards_done": tally.shards_done,
            "shards": tally.shards,
            "images_per_second": round(tally.images_per_second, 3),
            "seconds_left": None if left is None else round(left, 1),
            "failures": dict(tally.failures_by_worker()),
        }
        say(json.dumps(line), err=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        event = "finished" if error is None else "stopped"
        self._line(event, **({} if error is None else {"reason": str(error) or type(error).__name__}))


def reporter(log_format: str, title: str) -> Reporter:
    """Return the reporter of a format out of LOG_FORMATS."""
    return JsonReporter() if log_format == "json" else TextReporter(title)


def failures_in_words(tally: Tally) -> list[str]:
    """Return the summary's lines on what was begun again; none where nothing was."""
    if not tally.failures:
        return []
    shards = ", ".join(dict.fromkeys(failure.shard for failure in tally.failures))
    workers = ", ".join(f"{worker} ({count})" for worker, count in tally.failures_by_worker().items())
    return [f"  begun again after a worker failed: {shards}; failures by worker: {workers}"]
