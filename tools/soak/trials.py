"""A fault, the command that meets it, what that must say, and the set that must resume."""

import re
import time
from collections import Counter

from outcomes import Outcome
from processes import Cluster, Site, contents, differences, finished, wait_for

SET = "--object tetX --train 0 --test 1024 --size 96"
HERE = ("--workers", "2")
_SHOWN = 150  # characters of a message
_DIFFERS = {  # from run to run or from machine to machine, and what is shown instead
    r"\S*/bin/python": "python",
    r"/tmp/soak-[^/ ]*/": "",
    r"process \d+": "process N",
    r"\(\d+: .*\) is writing": "(N: symsol-annot render) is writing",
    r"127\.0\.0\.1:\d+": "127.0.0.1:PORT",
    r"symsol-annot-\w{8}": "symsol-annot-XXXXXXXX",
    r"held \d+ MiB": "held N MiB",
    r"test-\d{5}-of": "test-N-of",
}


def try_all(table, faults, undisturbed):
    """Suffer faults, each at a site of its own.

    Args:
        table: gets an outcome for each.
        faults: what, where, and a function that is handed a `Trial`.
        undisturbed: the set's bytes.
    """
    for fault, where, suffer in faults:
        start = time.monotonic()
        with Site() as site, Cluster(site) as cluster:
            trial = Trial(site, cluster, undisturbed)
            suffer(trial)
            trial.leave()
        table.add(Outcome(fault, where, time.monotonic() - start, trial.outcome, trial.wrong))


def undisturbed_set():
    """Return the bytes of the set that all faults are about, by name."""
    with Site() as site:
        ended = site.render(SET, *HERE).end()
        if ended.code != 0:
            raise RuntimeError(ended.err)
        return contents(site.out)


class Trial:
    """One fault at one site.

    Attributes:
        site, cluster: where; the cluster is not started.
        folder: the set's.
        wrong: what went otherwise than promised.
    """

    def __init__(self, site, cluster, undisturbed):
        self.site, self.cluster, self._undisturbed = site, cluster, undisturbed
        self.folder, self.wrong, self._said = site.out / "tetX", [], []

    @property
    def outcome(self):
        """What was said and done, in a line."""
        return "; ".join(
            f"{said} ({times} times)" if times > 1 else said for said, times in Counter(self._said).items()
        )

    def start(self, *options, **about):
        """Start the command; nothing but options means on this machine."""
        is_told_where = {"--cluster", "--scheduler-file", "--workers"} & set(options)
        return self.site.render(SET, *(() if is_told_where else HERE), *options, **about)

    def started(self, *options, shards=1, **about):
        """Start the command, and wait until some shards are finished."""
        running = self.start(*options, **about)
        self.expect(wait_for(lambda: len(finished(self.folder)) >= shards or not running.is_running), "no shard came")
        self.expect(running.is_running, "the command had ended before the fault")
        return running

    def refuses(self, running, *words, code=1):
        """A command must end with an error that has all words."""
        ended = running.end()
        self.expect(ended.code == code, f"ended with {ended.code}, expected {code}: {ended.err[-500:]}")
        self._check_words(ended, words)
        message = ended.err[max(ended.err.find("\nError: "), 0) :]
        self._said.append(f"exit {ended.code}, {_shortened(message)}")

    def survives(self, running, *words):
        """A command must say all words and finish by itself."""
        ended = running.end()
        self._check_words(ended, words)
        self._check_set(ended)
        self._said.append(
            f"said {_shortened(_line_with(words, ended.err))!r}, finished by itself" if words else "finished"
        )

    def resumes(self, *options, **about):
        """The same command, with other options where they make no other set, must finish the set."""
        before = finished(self.folder)
        self._check_set(self.start(*options, **about).end())
        after = finished(self.folder)
        changed = [name for name, status in before.items() if after.get(name) != status]
        self.expect("--repair" in options or not changed, f"were made again: {changed}")
        self._said.append("resumed")

    def expect(self, is_so, otherwise):
        """Note a contradiction."""
        if not is_so:
            self.wrong.append(otherwise)

    def note(self, words):
        """Add to the outcome."""
        self._said.append(words)

    def leave(self):
        """In the end, nothing is left but the set."""
        self.expect(not self.site.outlasting(self.site.blenders), "a Blender process is left")
        self.cluster.stop()
        self.wrong += self.site.faults()

    def _check_words(self, ended, words):
        for word in words:
            self.expect(word in ended.err, f"did not say {word!r}: {ended.err[-800:]}")
        self.wrong += tracebacks(ended.err)

    def _check_set(self, ended):
        self.expect(ended.code == 0, f"ended with {ended.code}, expected 0: {ended.err[-800:]}")
        self.wrong += tracebacks(ended.err)
        self.wrong += differences(self.site.out, self._undisturbed)


def tracebacks(said):
    """Return the first traceback in what a command said, but for those that it quotes from a worker."""
    lines = [*said.splitlines(), ""]
    starts = [number for number, line in enumerate(lines) if line.startswith("Traceback")]
    return ["printed a traceback: " + "\n".join(lines[max(starts[0] - 5, 0) :][:25])] if starts else []


def _line_with(words, text):
    return next(line for line in [*text.splitlines(), ""] if words[0] in line or not line)


def _shortened(message):
    """Return a message's beginning, without what differs from run to run."""
    message = " ".join(message.split())
    for pattern, instead in _DIFFERS.items():
        message = re.sub(pattern, instead, message)
    return message if len(message) <= _SHOWN else message[:_SHOWN] + "..."
